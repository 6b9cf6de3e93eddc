"""LaTeX tables through LaTeX itself, where it is installed."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from stat_helpers import make_seeds

from rbtm_bench.cli.commands import main

PAGE = (
    "\\documentclass{{article}}\\usepackage{{booktabs}}\\usepackage[T1]{{fontenc}}"
    "\\begin{{document}}\\tiny\n{}\n\\end{{document}}\n"
)


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no pdflatex is installed")
@pytest.mark.parametrize(
    "options", [[], ["--over-seeds"], ["--intervals"], ["--against", "selector=previous"]]
)
def test_it_compiles(
    options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = tmp_path / "runs"
    odd = "100%_of_$&#~^{x}"  # the name of a run, so a cell of the table
    make_seeds(runs, "previous", [5.0 + seed for seed in range(7)], name=odd)
    make_seeds(runs, "rbtm", [3.0 + seed for seed in range(7)], window=8)
    assert main(["table", str(runs), *options, "-f", "latex"]) == 0
    page = tmp_path / "page.tex"
    page.write_text(PAGE.format(capsys.readouterr().out))
    words = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", page.name]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout[-2000:]
    assert page.with_suffix(".pdf").read_bytes()[:4] == b"%PDF"
