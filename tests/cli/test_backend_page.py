"""docs/backends.md is what scripts/make_backend_page.py makes of the config group."""

from __future__ import annotations

from pathlib import Path

import pytest

from rbtm_bench.cli import backend_page
from rbtm_bench.runs import settings


def test_the_page_is_up_to_date(capsys: pytest.CaptureFixture[str]) -> None:
    assert backend_page.main(["--check"]) == 0, capsys.readouterr().out


def test_a_stale_page_fails_the_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(backend_page, "PAGE", tmp_path / "backends.md")
    assert backend_page.main(["--check"]) == 1
    assert backend_page.main([]) == 0 and backend_page.main(["--check"]) == 0
    text = backend_page.PAGE.read_text()
    backend_page.PAGE.write_text(text.replace("0.9", "0.8"))
    assert backend_page.main(["--check"]) == 1
    assert "run scripts/make_backend_page.py" in capsys.readouterr().out
    assert backend_page.main(["--nonsense"]) == 2


def test_every_backend_and_every_setting_is_on_the_page() -> None:
    text = backend_page.page()
    for name, node in settings.member_nodes("backend").items():
        assert isinstance(node, dict)
        part = text.partition(f"\n## {name}\n")[2].partition("\n## ")[0]
        for key in node:
            if key != "_target_":
                line = next(line for line in part.splitlines() if line.startswith(f"| `{key}`"))
                *_, comment, _ = (cell.strip() for cell in line.split("|"))
                assert comment, f"{name}.{key} has no comment in its YAML"


def test_every_backend_says_what_it_is() -> None:
    for line in backend_page.page().splitlines():
        if line.startswith("| [`"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            name, method, library, flat, space, converged, repeats = cells
            assert all((name, method, library, converged, repeats)) and "yes" in (flat, space), name


def test_comments_of_a_config(tmp_path: Path) -> None:
    path = tmp_path / "some.yaml"
    path.write_text(
        "# A method,\n# over two lines.\n_target_: a.B\nsize: 0.5   # m, of a cell\n"
        "    # that goes on\nwords: none\nvoxel_size: ${registration.voxel_size}\n"
    )
    about, described = backend_page.comments(path)
    assert about == "A method, over two lines."
    assert described == {
        "size": ("0.5", "m, of a cell that goes on"),
        "words": ("none", ""),
        "voxel_size": ("${registration.voxel_size}", "0: every point"),
    }
