"""LaTeX tables through LaTeX itself, where it is installed."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from stat_helpers import MM, make_replicates, make_run, make_seeds
from sweep_helpers import TESTS

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


COLUMN = (
    "\\documentclass[conference]{IEEEtran}\\usepackage{booktabs,siunitx}\\begin{document}"
    "\\input{table}As Table~\\ref{%s} shows.\\end{document}\n"
)


def has_ieee() -> bool:
    finder = shutil.which("kpsewhich")
    words = [finder or "", "IEEEtran.cls", "siunitx.sty", "booktabs.sty"]
    return finder is not None and subprocess.run(words, capture_output=True).returncode == 0


@pytest.mark.skipif(not has_ieee(), reason="no pdflatex with IEEEtran is installed")
def test_the_tutorial_s_page_is_one_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The document of docs/tutorials.md from a table and figures as they come, nothing scaled."""
    runs = tmp_path / "runs"
    for backend in ("open3d_p2p", "small_gicp_gicp", "plicp"):
        for number, selector in enumerate(["previous", "keyframe", "rbtm"], start=1):
            errors = [10.0**number + 0.1 * copy for copy in range(12)]
            make_replicates(runs, selector, errors, name=selector + backend, backend=backend)
    for path in runs.glob("*/metrics.json"):
        cost = {"ms_per_scan": 1.0 + len(path.parent.name)}
        path.write_text(json.dumps(json.loads(path.read_text()) | cost))
    words = ["table", str(runs), "--paper", "--rows", "selector", "--columns", "backend"]
    assert main(words) == 0
    (tmp_path / "table.tex").write_text(capsys.readouterr().out)
    words = ["--only", "errors", "--only", "accuracy_time", "--no-titles", "--format", "pdf"]
    assert main(["plot", str(runs), "--out", str(tmp_path), "--style", "paper", *words]) == 0
    text = (TESTS.parent / "docs" / "tutorials.md").read_text()
    (tmp_path / "page.tex").write_text(text.partition("```latex\n")[2].partition("```")[0])
    compiled = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"]
    for _ in range(2):
        done = subprocess.run(compiled, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout[-2000:]
    assert "(1 page," in done.stdout
    assert "Overfull" not in done.stdout and "undefined on" not in done.stdout


@pytest.mark.skipif(not has_ieee(), reason="no pdflatex with IEEEtran is installed")
@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--no-spread"],
        ["--rows", "selector", "--columns", "metric", "--metric", f"{MM},mean_gap"],
    ],
)
def test_the_paper_s_table_stands_alone_in_two_columns(
    options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With \\input alone: compiled, its label known, nothing wider than where it stands."""
    runs = tmp_path / "runs"
    for backend in ("p2p", "100%_of_$&#~^{x}"):
        for number, selector in enumerate(["previous", "keyframe", "fixed_gap", "rbtm"], start=1):
            errors = [10.0**number + 0.1 * copy for copy in range(12)]
            name = f"{selector}-{len(backend)}"
            make_replicates(runs, selector, errors, name=name, backend=backend)
    make_run(runs / "failed", "oldest", None)
    make_run(runs / "log", "rbtm", {"ape_rmse_m": 1.2e-6, "mean_gap": 2.0}, dataset="carmen")
    assert main(["table", str(runs), "--paper", *options]) == 0
    text = capsys.readouterr().out
    (tmp_path / "table.tex").write_text(text)
    label = text.partition("\\label{")[2].partition("}")[0]
    (tmp_path / "page.tex").write_text(COLUMN % label)
    words = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"]
    for _ in range(2):
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout[-2000:]
    assert "Overfull" not in done.stdout and "undefined on" not in done.stdout
