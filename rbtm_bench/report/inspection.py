"""What is behind one run, and what differs between two."""

from __future__ import annotations

import difflib
import shlex
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from rbtm_bench.core.columns import is_cost
from rbtm_bench.core.errors import DataError
from rbtm_bench.core.kinds import Kind
from rbtm_bench.report import frame, screen
from rbtm_bench.runs import experiment, stored
from rbtm_bench.runs.declared import ADDED, GROUPS, PLUGIN_GROUPS, SHARED, kind_of
from rbtm_bench.runs.stored import Run

WIDTH = 100
NAMED = 4
"""Runs that an error names at most."""

NO_RESULT = tuple(key for key, s in SHARED.items() if s.kind in (Kind.HOW, Kind.FEED))
"""Settings that change no number."""

SHOWN_COSTS = ("ms_per_scan", "peak_memory_mb", "reused")


# --- finding a run


def find_run(path: Path) -> Run:
    """The run in this folder, or the only one below it: "results/compare/none-previous".

    Raises ``DataError`` where the path is no run, naming runs of the same folder.
    """
    if (path / "run.json").is_file():
        return stored.read_run(path)
    if path.is_dir():
        below = sorted(file.parent for file in path.rglob("run.json"))
        if len(below) == 1:
            return stored.read_run(below[0])
        if below:
            names = ", ".join(str(run) for run in below[:NAMED])
            more = f" and {len(below) - NAMED} more" if len(below) > NAMED else ""
            raise DataError(f"{path}: holds {len(below)} runs, name one: {names}{more}")
        raise DataError(f"{path}: holds no run (no run.json in or below it)")
    beside = {file.parent.name: file.parent for file in path.parent.glob("*/run.json")}
    close = difflib.get_close_matches(path.name, beside, n=NAMED, cutoff=0.5)
    hint = f" Did you mean {' or '.join(str(beside[name]) for name in close)}?" if close else ""
    if not hint and beside:
        hint = f" Runs in {path.parent}: {', '.join(sorted(beside)[:NAMED])}, ..."
    what = "expected a run's folder" if path.exists() else "no such run"
    raise DataError(f"{path}: {what}.{hint}")


# --- one run


def run_text(run: Run) -> str:
    """A screen about a run: how it ended, what was typed, settings, versions, results, files."""
    record, config = run.record, run.config
    lines = [f"{run.path}: {_ended(record)}"]
    lines += _entry("typed", record.get("command"))
    lines += _entry("again", again(run))
    words = []
    if record.get("dataset_fingerprint"):
        words = [f"{record.get('scans')} scans", f"sha256 {_short(record['dataset_fingerprint'])}"]
    if record.get("skipped_records"):
        words.append(f"{record['skipped_records']} malformed records skipped")
    for group in (*PLUGIN_GROUPS, "metrics"):
        choice = record["choices"].get(group)
        node = config.get(group)
        if (choice is None and node is None) or choice == ADDED.get(group, ""):
            continue  # what does nothing, in groups that came later, is not told
        values = _settings(node if isinstance(node, dict) else {})
        text = f"{choice}: {' '.join(f'{k}={_word(v)}' for k, v in values.items())}"
        lines += _entry("data" if group == "dataset" else group, text.rstrip(": "))
        lines += _entry("", ", ".join(words)) if group == "dataset" else []
    if control := record.get("control"):
        lines += _entry("control", f"{control['how']}; of {control['of']}")
    if record.get("replicate"):
        lines += _entry("replicate", _replicate(record["replicate"]))
    rest = {
        k: v
        for k, v in config.items()
        if k not in (*GROUPS, "out", "overwrite") and kind_of(k) is not Kind.FEED
    }
    given = {k: v for k, v in _settings(rest).items() if v is not None}  # null: not asked for
    lines += _entry("other", " ".join(f"{k}={_word(v)}" for k, v in given.items()))
    versions = {"git": record.get("git"), **(record.get("versions") or {})}
    lines += _entry("versions", ", ".join(f"{k} {v}" for k, v in versions.items()))
    lines += _entry("machine", _machine(record))
    if run.done:
        lines += ["results", *screen.key_numbers(frame.row(run))]
    sizes = [(name, run.path / name) for name in experiment.FILES]
    files = [f"{name} {_size(path)}" for name, path in sizes if path.is_file()]
    return "\n".join([*lines, *_entry("files", ", ".join(files))])


def again(run: Run) -> str:
    """The command that repeats this very run, into a folder of its own."""
    command = shlex.split(run.record.get("command") or "")
    dirs = [b for a, b in pairwise(command) if a in ("--config-dir", "-cd")]
    left_out = ("out=", "overwrite=", "hydra", "pairs.")
    words = [w for w in run.record.get("overrides") or [] if not w.startswith(left_out)]
    gaps = (run.config.get("selector") or {}).get("gaps_from")
    if gaps and not any(word.startswith("selector.gaps_from=") for word in words):
        words.append(f"selector.gaps_from={gaps}")
    places = [word for folder in dirs for word in ("--config-dir", folder)]
    return shlex.join(["rbtm-bench", "run", *words, *places])


def _ended(record: dict[str, Any]) -> str:
    status = record.get("status")
    if status == "done":
        return f"done in {record.get('seconds') or 0.0:.1f} s, {record.get('finished')}"
    if status == "failed":
        return f"failed, {record.get('finished')}: {record.get('reason')} (more in run.json)"
    return f"{status}, {record.get('started')}, never ended"


def _replicate(draw: dict[str, Any]) -> str:
    """What a replicate was given, in words."""
    moved = draw.get("settings") or {}
    words = [
        f"{draw['number']}: from scan {draw['first_scan']}, scored from {draw['scored_from_scan']}",
        f"range noise {1e3 * draw['range_noise_m']:.3g} mm",
        f"odometry by {(draw['odometry_error'] or {}).get('source', 'nothing')}",
        *(f"{key}={_word(value)}" for key, value in moved.items()),
    ]
    return ", ".join(words)


def _machine(record: dict[str, Any]) -> str:
    core = record.get("core")
    pinned = "not pinned" if core is None else f"pinned to core {core}"
    return f"{record.get('host')}, {record.get('machine')}, {pinned}"


def _entry(name: str, text: str | None) -> list[str]:
    """A line, or several, under a name; nothing for no text."""
    if not text:
        return []
    indent = " " * 11
    return textwrap.wrap(
        f"{name:<11}{text}",
        WIDTH,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
        drop_whitespace=True,
    )


def _short(fingerprint: Any) -> str:
    return str(fingerprint)[:12] if fingerprint else "unknown"


def _size(path: Path) -> str:
    size = path.stat().st_size
    return f"{size} B" if size < 1000 else f"{size / 1000:.0f} kB"


def _word(value: Any) -> str:
    if value is None:
        return "null"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _settings(node: dict[str, Any], targets: bool = False) -> dict[str, Any]:
    """Settings as one level of keys ("final_pose.travel_m")."""
    flat: dict[str, Any] = {}
    for key, value in node.items():
        if isinstance(value, dict):
            flat |= {f"{key}.{k}": v for k, v in _settings(value, targets).items()}
        elif key != "_target_" or targets:
            flat[str(key)] = value
    return flat


# --- two runs


@dataclass(frozen=True)
class Differences:
    """What is not the same in two runs, by section; ``aside`` is shown, but counts for nothing."""

    sections: dict[str, list[str]]
    aside: list[str]

    @property
    def equal(self) -> bool:
        return not any(self.sections.values())


def compared(a: Run, b: Run) -> Differences:
    """Settings, versions, data and results that differ, a line each."""

    def of_record(*keys: str) -> list[dict[str, Any]]:
        return [{key: run.record.get(key) for key in keys} for run in (a, b)]

    data = of_record("dataset_fingerprint", "scans", "skipped_records")
    versions = [{"git": r.record.get("git"), **(r.record.get("versions") or {})} for r in (a, b)]
    ends, machines = of_record("status", "reason"), of_record("host", "machine", "core")
    every = dict.fromkeys(key for run in (a, b) for key in run.metrics)
    counted = [key for key in every if not is_cost(key)]
    return Differences(
        {
            "settings": _lines(_asked(a, b), _asked(b, a)),
            "versions": _lines(versions[0], versions[1]),
            "data": _lines(data[0], data[1]),
            "results": [*_lines(ends[0], ends[1]), *_numbers(a, b, counted), *_poses(a, b)],
        },
        [*_lines(machines[0], machines[1]), *_numbers(a, b, SHOWN_COSTS)],
    )


def differences_text(a: Run, b: Run, differences: Differences) -> str:
    """The differences as text, and in a last line what is the same."""
    lines = [f"- {a.path}", f"+ {b.path}"]
    for name, section in differences.sections.items():
        lines += [name, *(f"  {line}" for line in section)] if section else []
    if differences.aside:
        lines += ["not counted", *(f"  {line}" for line in differences.aside)]
    same = [name for name, section in differences.sections.items() if not section]
    return "\n".join([*lines, f"the same: {', '.join(same) or 'nothing'}"])


def _asked(run: Run, other: Run) -> dict[str, Any]:
    """The settings that may change a number, and the choices they belong to."""
    mine, theirs = run.record["choices"], other.record["choices"]
    config = {k: v for k, v in run.config.items() if k not in NO_RESULT}
    values = _settings(config, targets=True)
    if values.get("selector.gaps_from"):
        values["selector.gaps_from"] = Path(values["selector.gaps_from"]).name
    known = {k: v for k, v in values.items() if not _follows_choice(k, mine, theirs)}
    return {**mine, **known}


def _follows_choice(key: str, mine: dict[str, Any], theirs: dict[str, Any]) -> bool:
    """Whether a class differs only because another member of its group was chosen."""
    group = key.partition(".")[0]
    return key.endswith("_target_") and mine.get(group) != theirs.get(group)


def _lines(a: dict[str, Any], b: dict[str, Any]) -> list[str]:
    """ "selector.window  8 -> 16" for every key that differs; "-" is absent."""
    keys = [key for key in dict.fromkeys([*a, *b]) if a.get(key, _GONE) != b.get(key, _GONE)]
    width = max((len(key) for key in keys), default=0)
    lines = []
    for key in keys:
        sides = [values.get(key, _GONE) for values in (a, b)]
        words = ["-" if side is _GONE else _word(side) for side in sides]
        if words[0] == words[1]:  # they differ in later digits, or in type
            words = [repr(side) for side in sides]
        if key == "dataset_fingerprint":
            words = [_short(side) for side in sides]
        lines.append(f"{key:<{width}}  {words[0]} -> {words[1]}")
    return lines


_GONE = object()


def _numbers(a: Run, b: Run, keys: Sequence[str]) -> list[str]:
    """Lines of the metrics that differ, with their ratio; null and absent are the same."""
    x, y = ({k: run.metrics[k] for k in keys if run.metrics.get(k) is not None} for run in (a, b))
    lines = _lines(x, y)
    for i, line in enumerate(lines):
        key = line.split()[0]
        if min(x.get(key, 0), y.get(key, 0)) > 0:
            lines[i] += f"  (x {y[key] / x[key]:.4g})"
    return lines


def _poses(a: Run, b: Run) -> list[str]:
    """Where the trajectories part, and by how much; nothing if either is missing, or if they
    are the same to the bit."""
    from rbtm_bench.core.geometry import inverse, rotation_angle, translation_norm
    from rbtm_bench.core.trajectory import Trajectory

    files = [run.path / "trajectory.tum" for run in (a, b)]
    if not all(file.is_file() for file in files):
        return []
    x, y = (Trajectory.read_tum(file) for file in files)
    if len(x) != len(y):
        return [f"trajectory  {len(x)} -> {len(y)} poses"]
    apart = np.flatnonzero((x.T_world_scan != y.T_world_scan).any(axis=(1, 2)))
    if len(apart) == 0:
        return []
    off = inverse(x.T_world_scan) @ y.T_world_scan
    far, turned = translation_norm(off).max(), np.degrees(rotation_angle(off).max())
    return [f"trajectory  from scan {apart[0]} on, at most {far:.3g} m and {turned:.3g} deg apart"]
