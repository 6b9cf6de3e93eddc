"""The page: read runs, pack what it shows, fill the template, write one file."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from rbtm_bench.core.errors import RbtmBenchError, one_line
from rbtm_bench.core.files import write_text
from rbtm_bench.page import runs as reading
from rbtm_bench.page import scans as data
from rbtm_bench.page import table
from rbtm_bench.page.choices import REPLAYED, choices
from rbtm_bench.page.packing import as_script
from rbtm_bench.page.runs import STORED, Track
from rbtm_bench.page.scans import Scans
from rbtm_bench.report import frame
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.runs import stored

SCRIPTS = ("core", "table", "charts", "heat", "plane", "scan", "main")
"""The page's programs, in order."""
THIN_PATHS = 200
"""Rows beyond those kept scan by scan that have a path at all."""


def write(paths: Sequence[Path], out: Path, trust: bool = False) -> list[str]:
    """Write the page of the runs in or below the paths, and return what was left out of it, a line
    each. Raises ``DataError`` for a path without runs."""
    text, notes = page(paths, trust)
    write_text(out, text)
    return notes


def page(paths: Sequence[Path], trust: bool = False, served: str = "") -> tuple[str, list[str]]:
    """The page as HTML, and what was left out of it. ``served`` is the version that a server's page
    watches."""
    runs = stored.find_runs(paths)
    methods = frame.methods(runs)
    places = table.where(paths)
    payload: dict[str, Any] = {
        "title": f"{', '.join(path.resolve().name for path in paths)}",
        "counts": [len(methods), len(runs), sum(not run.done for run in runs)],
        **table.first_screen(methods, runs, places),
    }
    shown = [_method_of(row, methods) for row in payload["rows"]]
    payload["scenes"], payload["runs"], notes = _details(shown, payload["rows"], trust)
    payload["notes"] = notes
    payload["served"] = served
    return html(payload), notes


def _method_of(row: dict[str, Any], methods: Sequence[MethodRuns]) -> MethodRuns:
    return methods[row.pop("method")]


def html(payload: dict[str, Any]) -> str:
    """The template around a payload: its only scripts are those of this package, by their hash."""
    from jinja2 import Environment

    files = resources.files("rbtm_bench.page")
    script = "\n".join((files / f"{name}.js").read_text("utf-8") for name in SCRIPTS)
    script = f'(() => {{\n"use strict";\n{script}\n}})();'
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    template = Environment(autoescape=True, keep_trailing_newline=True).from_string(
        (files / "page.html").read_text("utf-8")
    )
    return template.render(
        title=payload["title"].encode("utf-8", "replace").decode(),
        css=(files / "page.css").read_text("utf-8"),
        script=script,
        digest=digest,
        served=payload["served"],
        data=as_script(payload),
    )


def _details(
    methods: Sequence[MethodRuns], rows: Sequence[dict[str, Any]], trust: bool
) -> tuple[list[dict[str, Any]], list[dict[str, Any] | None], list[str]]:
    """The data sets and, beside every row, what is drawn of its run."""
    details: list[dict[str, Any] | None] = [None] * len(methods)
    notes: list[str] = []
    room, thin, tracks = STORED, THIN_PATHS, {}
    for i in _order(rows):
        run = table.representative(methods[i])
        count = int(run.record.get("scans") or 0)
        whole = count <= room
        if not run.done or (not whole and not thin):
            continue
        try:
            track = reading.read_track(run, whole)
            details[i] = reading.detail(track, whole)
        except RbtmBenchError as error:
            notes.append(one_line(error))
            continue
        room, thin = (room - count, thin) if whole else (room, thin - 1)
        if whole:
            tracks[i] = track
    done = [any(run.done for run in method.runs) for method in methods]
    left = sum(
        d is None or not d["whole"] for d, is_done in zip(details, done, strict=True) if is_done
    )
    if left:
        notes.append(f"{left} of {len(rows)} rows are kept without their scans")
    scenes = _scenes(tracks, rows, details, trust)
    return scenes, details, notes


def _order(rows: Sequence[dict[str, Any]]) -> list[int]:
    """Rows in the order in which they are worth their room: the best of every data set and
    backend, of every selector, the others; each as ranked."""
    firsts: dict[Any, None] = {}
    for keys in (("data", "backend"), ("data", "backend", "selector")):
        seen: set[tuple[Any, ...]] = set()
        for i, row in enumerate(rows):
            place = tuple(row["cells"].get(key) for key in keys)
            if place not in seen:
                seen.add(place)
                firsts[i] = None
    return [*firsts, *(i for i in range(len(rows)) if i not in firsts)]


def _scenes(
    tracks: dict[int, Track],
    rows: Sequence[dict[str, Any]],
    details: Sequence[dict[str, Any] | None],
    trust: bool,
) -> list[dict[str, Any]]:
    """The data sets behind the runs, each opened once, and into the runs' details what follows
    from the scans."""
    groups: dict[str, list[int]] = {}
    for i, track in tracks.items():
        run = track.run
        groups.setdefault(str(run.record.get("dataset_fingerprint") or run.path), []).append(i)
    scenes: list[dict[str, Any]] = []
    replays = REPLAYED
    for members in groups.values():
        first = tracks[members[0]]
        scene: dict[str, Any] = {"name": rows[members[0]]["cells"]["data"]}
        scene |= {"planar": first.planar, **reading.truth(first)}
        scans = _opened(first, trust, data.POINTS // len(groups), scene)
        keys: list[str] = []
        for i in members:
            detail = details[i]
            assert detail is not None
            detail["scene"] = len(scenes)
            if scans is None:
                detail["map"] = reading.own_map(tracks[i].run)
                continue
            if replays < len(tracks[i]):
                detail["unreplayed"] = "candidates are kept for the first rows alone"
                continue
            replays -= len(tracks[i])
            _add_choices(detail, tracks[i], scans, trust, keys)
        scene["curves"] = [] if scans is None else [scans.described[key][1] for key in keys]
        scenes.append(scene)
    return scenes


def _opened(track: Track, trust: bool, budget: int, scene: dict[str, Any]) -> Scans | None:
    """The scans of a data set, in the scene too; None, and why, where they cannot be read."""
    try:
        scans = data.open_scans(track.run, trust, budget)
    except Exception as error:  # another package's reader raises what it likes
        scene["note"] = f"scans are not shown: {one_line(error)}"
        return None
    scene["points"] = data.packed_points(scans)
    return scans


def _add_choices(
    detail: dict[str, Any], track: Track, scans: Scans, trust: bool, keys: list[str]
) -> None:
    try:
        detail["choices"] = choices(track, scans, trust)
    except Exception as error:  # a plug-in raises what it likes
        detail["unreplayed"] = f"candidates are not shown: {one_line(error)}"
        return
    key = json.dumps(track.run.config.get("similarity"), sort_keys=True)
    if key in scans.described:
        if key not in keys:
            keys.append(key)
        detail["curve"] = keys.index(key)
