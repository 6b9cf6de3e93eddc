"""The list of mutants fits the tree: every change has its place and its test. None is run here."""

from __future__ import annotations

import ast
import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

REPO = Path(__file__).resolve().parents[2]


def load() -> ModuleType:
    """scripts/mutants.py."""
    spec = importlib.util.spec_from_file_location("mutants", REPO / "scripts" / "mutants.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["mutants"] = module
    spec.loader.exec_module(module)
    return module


SCRIPT = load()
MUTANTS = SCRIPT.read_list()


@cache
def functions_of(file: str) -> set[str]:
    """The names of a file's test functions."""
    tree = ast.parse((REPO / file).read_text("utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_there_are_forty() -> None:
    assert len(MUTANTS) == len({mutant.name for mutant in MUTANTS}) == 40


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_every_change_has_one_place_and_a_test(mutant: Any) -> None:
    """And what comes of it is Python."""
    file = SCRIPT.place(mutant, REPO)
    ast.parse(file.read_text("utf-8").replace(mutant.old, mutant.new))
    path, _, function = mutant.test.partition("::")
    assert function.partition("[")[0] in functions_of(path)


def example(root: Path, **change: Any) -> Any:
    """A mutant of a package of two files in ``root``."""
    folder = root / "rbtm_bench" / "part"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "one.py").write_text("a = 1\nb = 2\n")
    (folder / "two.py").write_text("b = 2\nb = 3\n")
    words = {"name": "x", "where": "part", "old": "a = 1", "new": "a = 9", "test": "t.py::test"}
    return SCRIPT.Mutant(**{**words, **change})


def test_a_change_is_taken_back(tmp_path: Path) -> None:
    mutant = example(tmp_path)
    file = SCRIPT.place(mutant, tmp_path)
    assert file.name == "one.py"
    with pytest.raises(KeyboardInterrupt), SCRIPT.changed(mutant, tmp_path):
        assert file.read_text() == "a = 9\nb = 2\n"
        raise KeyboardInterrupt
    assert file.read_text() == "a = 1\nb = 2\n"


@pytest.mark.parametrize(
    "change", [{"old": "c = 1"}, {"old": "b = 2"}, {"where": "part/two.py", "old": "b ="}]
)
def test_a_change_without_one_place_is_refused(tmp_path: Path, change: dict[str, str]) -> None:
    with pytest.raises(SCRIPT.ListError, match=r"x: .* stands [02] times"):
        SCRIPT.place(example(tmp_path, **change), tmp_path)


@pytest.mark.parametrize(
    ("code", "outcome"), [(0, "SURVIVED"), (1, "killed"), (2, "SURVIVED"), (None, "SURVIVED")]
)
def test_only_a_test_that_ran_and_failed_kills(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int | None, outcome: str
) -> None:
    """Not one that passed, could not be collected, or did not end."""
    monkeypatch.setattr(SCRIPT, "run_tests", lambda *_: (code, "the end"))
    verdict = SCRIPT.judge(example(tmp_path), tmp_path)
    assert verdict.outcome == outcome
    assert ("the end" in verdict.line) == (outcome == "SURVIVED")


def test_who_passes_unmutated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All cases of a test have to pass; skipped is not passed."""
    said = """
PASSED t.py::whole[a b-1]
PASSED t.py::whole[c]
PASSED t.py::part[a]
PASSED t.py::case[a]
FAILED t.py::part[b] - assert 1 == 2
FAILED t.py::case[b] - assert 1 == 2
SKIPPED [1] t.py:9: no data
"""
    asked: list[list[str]] = []

    def pretended(root: Path, words: list[str], jit: bool, limit: float) -> tuple[int, str]:
        asked.append(words)
        return 1, said

    monkeypatch.setattr(SCRIPT, "run_tests", pretended)
    tests = ["t.py::whole", "t.py::part", "t.py::case[a]", "t.py::skipped"]
    mutants = [example(tmp_path, test=test) for test in tests]
    mutants.append(example(tmp_path, test="t.py::uncompiled", jit=False))
    found, last = SCRIPT.passing(tmp_path, mutants, True)
    assert found == {"t.py::whole", "t.py::case[a]"} and last == "SKIPPED [1] t.py:9: no data"
    assert asked == [["-rA", *sorted(tests)]]
