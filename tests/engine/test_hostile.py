"""Strangers that misbehave beside built-in methods: theirs is the row that says so, the others
have the bits that they have alone, and nothing is left running."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from hostile_plugins import SLEEP
from sweep_helpers import call, record_of

FEW = ("dataset.scans=10", "dataset.beams=91", "pictures=false", "controls=none")
SMALL = (*FEW, "metrics=none", "--jobs", "1")
CALM = ("backend=open3d_p2p,plicp", "selector=previous,rbtm", "selector.window=5")
CLASSES = ("backend", "selector", "similarity", "target", "guess", "check")
DONE = "done"
"""A row like any other: what it did was harmless to others."""

BACKENDS = {
    "chdir": DONE,
    "fork": "left a process behind",
    "daemon": "left a process behind",
    "daemon_then_death": "the process died: exit code 0",
    "detach": "left a process behind",
    "exit0": "the process died: exit code 0",
    "abort": "the process died: signal 6 (SIGABRT)",
    "stop_itself": DONE,
    "sys_exit": "SystemExit: 0",
    "interrupt": "KeyboardInterrupt",
    "generator_exit": "GeneratorExit",
    "thread": DONE,
    "numpy_state": DONE,
    "warnings": DONE,
    "environment": DONE,
    "sys_path": DONE,
    "signal_handlers": DONE,
    "patch_numpy": "TypeError",
    "patch_rbtm": "TypeError",
    "close_output": DONE,
    "close_all": "it closed the channel to its parent",
    "print": DONE,
    "garbage": "it wrote onto the channel to its parent",
    "delete_own": "cannot be written: No such file or directory",
    "spoil_others": "was changed while it ran, and put back",
    "delete_all": "was changed while it ran, and put back",
    "speechless": "SpeechlessError: (its words cannot be read: RuntimeError)",
    "unpicklable": "1 2",
    "huge_message": "xxx ... (100000000 characters)",
    "crowd": "OSError: [Errno 24]",
    "recursion": "RecursionError: deep",
    "stop_iteration": "RuntimeError: generator raised StopIteration",
    "memory": "MemoryError",
    "scan_points": "changed scan 3's points",
    "scan_ranges": "changed scan 3's ranges",
    "scan_angles": "changed scan 3's angles",
    "scan_odometry": "changed scan 3's odometry",
    "other_scan": "HostileBackend.prepare returned scans [1] for scan 0",
    "write_source": "changed scan 1's prepared points",
    "write_target": "changed scan 0's prepared points",
    "write_guess": DONE,
    "same_object": DONE,
    "huge_backend_error": "none of 9 scans was registered: xxx",
    "counts": "TypeError: 'str' object cannot be interpreted as an integer",
    "nothing": "HostileBackend.align returned NoneType: expected an Alignment",
    **dict.fromkeys(("float32", "frozen"), DONE),
}
STEPS = {
    **dict.fromkeys(
        ("undefined", "infinite", "reflected", "shape", "ragged"), "returned no rigid motion"
    ),
    **dict.fromkeys(("complex", "complex_zero"), "complex128, not real numbers"),
    "words": "not real numbers",
    "far": "HostileBackend returned an implausible motion: 1e+09 m > 10000 m",
}
"""Poses that are none: every scan is predicted, and says why."""

SELECTORS = {
    "minus": "HostileSelector chose position -1 in a window of",
    "beyond": "HostileSelector chose position",
    "half": "HostileSelector chose position 0.5",
    "truth": "HostileSelector chose position True",
    "word": "HostileSelector chose position '0'",
    "twice": "expected members, each once",
    "nameless": "HostileSelector gives 17 as a reason",
    "write_models": "ValueError: assignment destination is read-only",
    "future": "HostileSelector chose Candidate(model=2",
    "itself": "HostileSelector chose Candidate(model=1",
    "none_at_all": "HostileSelector.choose returned NoneType",
    "pick_true": "HostileSelector.pick chose True",
    "move_pose": "changed scan 0's pose",
    "move_odometry": "changed scan 0's odometry",
    "prepared": "changed scan 0's prepared points",
    "empty_window": "IndexError",
}
SIMILARITIES = {
    "complex": "HostileSimilarity: scores of complex128",
    "infinite": "HostileSimilarity: a score is infinite",
    "long": "HostileSimilarity: scores of shape",
    "words": "HostileSimilarity: scores of str",
    "nones": "HostileSimilarity: scores of object",
    "nothing": "HostileSimilarity: scores of shape ()",
    "matrix": "HostileSimilarity.describe returned float64 of shape (3, 3)",
    "scan_points": "changed scan 0's points",
    "scan_ranges": "changed scan 0's ranges",
    "window": DONE,
    "patch_judge": DONE,
}
TARGETS = {
    "points": "HostileTarget.build returned ndarray: expected a Prepared",
    "lookalike": "HostileTarget.build returned SimpleNamespace",
    "future": "HostileTarget.build: of scans [100], not all earlier than 1",
    "write": "changed scan 0's prepared points",
    "misnamed": DONE,
}
GUESSES = {
    "none": DONE,
    "complex": "HostileGuess.predict returned complex128",
    "undefined": "no rigid motion",
    "shape": "HostileGuess.predict returned float64 of shape (3, 4)",
    "years": "HostileGuess.observe returned inf",
    "no_time": "TypeError",
    "write_scan": "changed scan 0's points",
}
CHECKS = {
    "number": "HostileCheck.reject returned int",
    "itself": "HostileCheck.reject returned RegistrationResult",
    "long": "none of 9 scans was registered: xxx",
    "write": "its motion is not rigid",
    "write_guess": DONE,
}
METRICS = {
    "undefined": "HostileMetric: hostile is nan: expected a number or None",
    "others": "HostileMetric: registrations is not a column of its own",
    "words": "HostileMetric: hostile is good",
    "write": "ValueError: assignment destination is read-only",
}


@pytest.fixture
def configs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Configs of the plug-ins, and a place from where they reach the comparison's folder."""
    monkeypatch.chdir(tmp_path)
    for group in CLASSES:
        text = f"_target_: hostile_plugins.Hostile{group.title()}\nhow: none\n"
        (tmp_path / "configs" / group).mkdir(parents=True)
        (tmp_path / "configs" / group / "hostile.yaml").write_text(text)
    (tmp_path / "configs" / "metrics").mkdir()
    (tmp_path / "configs" / "metrics" / "none.yaml").write_text("{}\n")
    text = "mine:\n  _target_: hostile_plugins.HostileMetric\n  how: none\n"
    (tmp_path / "configs" / "metrics" / "hostile.yaml").write_text(text)
    return str(tmp_path / "configs")


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What the built-in methods give alone."""
    out = tmp_path_factory.mktemp("calm") / "c"
    words = [word for word in SMALL if word != "metrics=none"]
    assert call("compare", *CALM, *words, f"out={out}")[0] == 0
    return trajectories(out)


def trajectories(out: Path) -> dict[str, bytes]:
    return {p.parent.name: p.read_bytes() for p in sorted(out.glob("*/trajectory.tum"))}


def sleepers() -> list[int]:
    """Processes that a plug-in started and that are still there."""
    pids = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if SLEEP[-1].encode() in path.read_bytes():
                pids.append(int(path.parent.name))
        except OSError:
            continue
    return pids


def compared(configs: str, out: Path, *words: str) -> dict[str, dict[str, Any]]:
    """The records of a comparison's runs, by name."""
    call("compare", *SMALL, "--config-dir", configs, f"out={out}", *words)
    assert not sleepers(), "a process outlives the comparison"
    return {path.parent.name: record_of(path.parent) for path in out.glob("*/run.json")}


def check_rows(
    records: dict[str, dict[str, Any]], expected: dict[str, str], plugin: str, name: str
) -> None:
    """That the rows ``name`` (with {how}) say what is expected, in one line that names theirs."""
    wrong = []
    for how, reason in expected.items():
        record = records[name.format(how=how)]
        said = record["reason"] or record["status"]
        names = said == DONE or plugin in said
        if reason not in said or not names or "\n" in said or len(said) > 1200:
            wrong.append(f"{how}: {said[:200]!r}, expected {reason!r}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_backends(configs: str, calm: dict[str, bytes]) -> None:
    ways = ",".join([*BACKENDS, *STEPS])
    words = ("backend=open3d_p2p,hostile,plicp", f"backend.how={ways}", "selector=previous")
    records = compared(configs, Path("o"), *words)
    check_rows(records, BACKENDS, "backend=hostile", "hostile-previous-how={how}")
    for how, reason in STEPS.items():
        steps = pd.read_parquet(f"o/hostile-previous-how={how}/steps.parquet")
        assert set(steps["status"][1:]) == {"predicted"} and reason in steps["reason"][1], how
    after = trajectories(Path("o"))
    for name in ("open3d_p2p-previous", "plicp-previous"):
        assert after[name] == calm[name], f"{name}: {records[name]['reason']}"


@pytest.mark.slow
def test_an_endless_one(configs: str, calm: dict[str, bytes]) -> None:
    """Its limit counts in a worker that is warm."""
    words = ("backend=hostile,plicp", "backend.how=none,endless", "selector=previous")
    records = compared(configs, Path("o"), *words, "time_limit=12")
    check_rows(
        records, {"endless": "time limit of 12 s"}, "backend=hostile", "hostile-previous-how={how}"
    )
    assert trajectories(Path("o"))["plicp-previous"] == calm["plicp-previous"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("group", "expected", "beside"),
    [
        ("selector", SELECTORS, "rbtm"),
        ("similarity", SIMILARITIES, "curvature_circular"),
        ("target", TARGETS, "single"),
        ("guess", GUESSES, "constant_velocity"),
        ("check", CHECKS, "none"),
        ("metrics", METRICS, None),
    ],
)
def test_other_plugins(
    configs: str,
    calm: dict[str, bytes],
    group: str,
    expected: dict[str, str],
    beside: str | None,
) -> None:
    """Rows with a built-in backend and a stranger; the built-in ones get none of their pairs."""
    words = ["backend=open3d_p2p,plicp", "selector.window=5"]
    words += [f"{group}=hostile,{beside}" if beside else f"{group}=hostile"]
    words += [] if group == "selector" else ["selector=rbtm"]
    key = "metrics.mine.how" if group == "metrics" else f"{group}.how"
    records = compared(configs, Path("o"), *words, f"{key}={','.join(expected)}")
    middle = {"selector": "hostile", "metrics": "rbtm"}.get(group, "rbtm-hostile")
    for backend in ("open3d_p2p", "plicp"):
        check_rows(records, expected, f"{group}=hostile", f"{backend}-{middle}-how={{how}}")
    if group in (
        "similarity",
        "target",
    ):  # which may have spoilt registrations of the built-in ones
        words = [*CALM, *(word for word in SMALL if "metrics" not in word)]
        words += ["out=again", f"pairs.folder={Path('o/pairs').resolve()}"]
        assert call("compare", *words)[0] == 0
        assert trajectories(Path("again")) == calm
