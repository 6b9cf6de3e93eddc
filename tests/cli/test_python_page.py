"""docs/python.md is what scripts/make_python_page.py makes of the docstrings."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest

import rbtm_bench
from rbtm_bench import api
from rbtm_bench.cli import python_page


def test_the_page_is_up_to_date(capsys: pytest.CaptureFixture[str]) -> None:
    assert python_page.main(["--check"]) == 0, capsys.readouterr().out


def test_a_stale_page_fails_the_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(python_page, "PAGE", tmp_path / "python.md")
    assert python_page.main(["--check"]) == 1
    assert python_page.main([]) == 0 and python_page.main(["--check"]) == 0
    python_page.PAGE.write_text(python_page.PAGE.read_text().replace("fitness", "fit"))
    assert python_page.main(["--check"]) == 1
    assert "run scripts/make_python_page.py" in capsys.readouterr().out
    assert python_page.main(["--nonsense"]) == 2


@pytest.mark.parametrize("name", python_page.FUNCTIONS)
def test_every_parameter_is_described(name: str) -> None:
    part = python_page.page().partition(f"\n## {name}\n")[2].partition("\n## ")[0]
    described = [line for line in part.splitlines() if line.startswith("- `")]
    for parameter in inspect.signature(getattr(api, name)).parameters:
        assert any(parameter in line.split("`")[1] for line in described), parameter
    for section in ("Parameters", "Returns", "Raises"):
        assert f"**{section}**" in part


def test_every_name_is_on_the_page() -> None:
    page = python_page.page()
    for name in rbtm_bench.__all__:
        assert f"\n## {name}\n" in page or f"| `{name}` |" in page, name
