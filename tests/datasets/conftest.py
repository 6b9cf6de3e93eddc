"""Fixtures of the data set tests."""

from __future__ import annotations

from pathlib import Path

import pytest
from carmen_writer import Write


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes lines to a file and gives its path."""

    def write_lines(*lines: str, name: str = "robot.log") -> str:
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n")
        return str(path)

    return write_lines
