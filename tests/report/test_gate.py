"""The gate: limits, regressions by the rule of "better", its comment and exit codes."""

from __future__ import annotations

from pathlib import Path

import pytest
from stat_helpers import MM, make_replicates, make_run, make_seeds
from sweep_helpers import call

TEN = [10.0 + k for k in range(10)]


def replicates(folder: Path, factor: float, selector: str = "rbtm", name: str = "now") -> Path:
    make_replicates(folder, selector, [factor * error for error in TEN], prefix=f"{name} {factor}")
    return folder


def gate(*words: object) -> tuple[int, list[str]]:
    code, out, error = call("gate", *map(str, words))
    assert error == "" and code in (0, 1)
    return code, out.splitlines()


def row(lines: list[str], start: str) -> str:
    (one,) = [line for line in lines if line.startswith(f"| {start}")]
    return one


# --- limits


def test_limits_on_medians(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", [1.0, 2.0, 9.0])
    code, lines = gate(tmp_path, "--max", f"{MM}=2", "--min", "mean_gap=3")
    assert code == 0 and lines[0] == "### rbtm-bench gate: passed" and lines[2] == "2 passed."
    code, lines = gate(tmp_path, "--max", f"{MM}=1.99")
    assert code == 1 and lines[0].endswith("failed")
    assert f"| p2p previous | {MM} at most 1.99 | 2 |" in row(lines, "**failed**")
    assert gate(tmp_path, "--min", "mean_gap=3.01")[0] == 1


def test_a_failed_run_and_a_missing_number_fail(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", [1.0, None])
    code, lines = gate(tmp_path, "--max", f"{MM}=5")
    assert code == 1 and "| runs done | 1 of 2 failed |" in row(lines, "**failed**")
    make_run(tmp_path / "other", "rbtm", {"mean_gap": 1.0})
    _, lines = gate(tmp_path / "other", tmp_path, "--max", f"{MM}=5")
    assert any(f"| p2p rbtm | {MM} at most 5 | none |" in line for line in lines)


def test_only_some_methods(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", [9.0])
    make_seeds(tmp_path, "rbtm", [1.0])
    assert gate(tmp_path, "--max", f"{MM}=5")[0] == 1
    assert gate(tmp_path, "--max", f"{MM}=5", "--filter", "selector == 'rbtm'")[0] == 0


# --- against a baseline


@pytest.mark.parametrize(("factor", "code", "words"), [
    (3.0, 1, "3 times worse on this log"), (1.0 / 3.0, 0, "3 times better on this log"),
    (1.5, 0, "not beyond 2, what placebos reach"),
])  # fmt: skip
def test_replicates_are_judged(tmp_path: Path, factor: float, code: int, words: str) -> None:
    old, new = replicates(tmp_path / "old", 1.0), replicates(tmp_path / "new", factor)
    found, lines = gate(new, "--baseline", old)
    assert found == code
    assert words in row(lines, "**failed**" if code else "passed")
    assert lines[-1].startswith("- better or worse: p &lt; 0.05 after Holm")


def test_seven_replicates_are_not_enough(tmp_path: Path) -> None:
    for name, factor in (("old", 1.0), ("new", 9.0)):
        make_replicates(tmp_path / name, "rbtm", [factor * e for e in TEN[:7]], prefix=name)
    code, lines = gate(tmp_path / "new", "--baseline", tmp_path / "old")
    assert code == 0 and "7 distinct trajectories of 8" in row(lines, "passed")


def test_one_run_is_not_judged(tmp_path: Path) -> None:
    for name, error in (("old", 1.0), ("new", 99.0)):
        told = {"trajectory_sha256": name}
        make_run(tmp_path / name / "a", "rbtm", {MM: error}, fingerprint="f", told=told)
    code, lines = gate(tmp_path / "new", "--baseline", tmp_path / "old")
    assert code == 0 and lines[2] == "1 not judged."
    assert "| 99, was 1 | one run: not judged |" in row(lines, "not judged")


def test_equal_trajectories_pass(tmp_path: Path) -> None:
    for name in ("old", "new"):
        replicates(tmp_path / name, 1.0)
    code, lines = gate(tmp_path / "new", "--baseline", tmp_path / "old")
    assert code == 0 and "it is equal, trajectory by trajectory" in row(lines, "passed")


def test_what_is_new_and_what_is_gone(tmp_path: Path) -> None:
    for name, selectors in (("old", ("rbtm", "oldest")), ("new", ("rbtm", "previous"))):
        for selector in selectors:
            replicates(tmp_path / name, 1.0, selector)
    _, lines = gate(tmp_path / "new", "--baseline", tmp_path / "old")
    assert "- not in the baseline: p2p previous (corridor)" in lines
    assert "- in the baseline alone: p2p oldest (corridor)" in lines


def test_names_and_reasons_are_text(tmp_path: Path) -> None:
    reason = {"reason": "<script>alert(1)</script> | a\n# title"}
    make_run(tmp_path / "a", "rbtm", None, told=reason)
    make_run(tmp_path / "b", "previous", {MM: 1.0})
    code, lines = gate(tmp_path, "--max", f"{MM}=5")
    assert code == 1 and "&lt;script&gt;alert(1)&lt;/script&gt; \\| a # title" in "\n".join(lines)


# --- mistakes


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ("", "nothing is asked: expected --max, --min or --baseline"),
        ("--max final", "--max final: expected KEY=NUMBER"),
        ("--max x=nan", "--max x=nan: expected KEY=NUMBER"),
        ("--min final_translation_eror_mm=1", "Did you mean final_translation_error_mm?"),
        ("--metric a", "--metric: goes with --baseline"),
        ("--baseline nowhere", "nowhere: no such file or folder"),
        ("--baseline other", "none of its methods has the settings of one of these"),
        ("--baseline runs --metric x", "--metric x: no method has it on the same data in both"),
        ("--max x=1 --filter backend==1", "no row is left"),
    ],
)
def test_mistakes_are_exit_code_2(tmp_path: Path, words: str, error: str) -> None:
    make_seeds(tmp_path / "runs", "previous", [1.0])
    make_seeds(tmp_path / "other", "rbtm", [1.0])
    code, out, told = call("gate", "runs", *words.split(), cwd=tmp_path)
    assert (code, out) == (2, "") and error in told and len(told.splitlines()) == 1
