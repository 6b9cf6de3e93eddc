"""docs/quickstart.ipynb runs as it stands, and is committed without outputs."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[2] / "docs" / "quickstart.ipynb"
CELLS = json.loads(NOTEBOOK.read_text())["cells"]
CODE = [cell for cell in CELLS if cell["cell_type"] == "code"]


def test_no_outputs_are_kept() -> None:
    assert CODE and all(c["outputs"] == [] and c["execution_count"] is None for c in CODE)
    assert len({cell["id"] for cell in CELLS}) == len(CELLS)
    assert NOTEBOOK.stat().st_size < 10_000


@pytest.mark.slow
def test_every_cell_runs(tmp_path: Path) -> None:
    """In a fresh process, an empty folder, and as the process's ``__main__``, as a kernel does."""
    script = tmp_path / "cells.py"
    script.write_text("\n\n".join("".join(cell["source"]) for cell in CODE))
    done = subprocess.run(
        [sys.executable, script], cwd=tmp_path, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    assert "ape_rmse_m" in done.stdout and "plicp" in done.stdout
    assert (tmp_path / "quickstart" / "summary.csv").is_file()
