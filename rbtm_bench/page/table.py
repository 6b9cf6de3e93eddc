"""The page's first screen as plain data: the answer, the table's columns and rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rbtm_bench.core.columns import KNOWN, REFERENCES
from rbtm_bench.plots import labels, style
from rbtm_bench.plots.looks import looks
from rbtm_bench.report import answer, best_settings, inspection, render, screen, verdict
from rbtm_bench.report.frame import METHOD, MethodRuns, table_of
from rbtm_bench.report.references import judged
from rbtm_bench.report.replicates import counted, number_of, value_of
from rbtm_bench.runs.declared import PLUGIN_GROUPS
from rbtm_bench.runs.stored import Run

GREEN, PURPLE = "#009E73", "#CC79A7"
LIGHT = (
    *(style.BLUE, style.VERMILION, GREEN, style.ORANGE, PURPLE, style.SKY, style.NAVY),
    style.BLACK,
)
"""Okabe and Ito's colours: one a backend."""
DARK = ("#5AA9E6", "#F58A4B", "#3CC79E", "#F0BE4A", "#E3A5CA", "#8ED0F5", "#9DB4D6", "#F2F2F2")
"""Their counterparts on a dark ground."""
DOTS = 40
"""Values of replicates or seeds that are drawn as dots, at most."""
COST = "ms_per_scan"
NAMES = (render.WINNER, *METHOD, "control", "seeds", "replicates", "status")


def first_screen(methods: Sequence[MethodRuns], runs: Sequence[Run], places: str) -> dict[str, Any]:
    """Answer, verdict, columns and rows of methods, ranked; ``places`` are the paths as typed."""
    table = best_settings.ranked(table_of(methods))
    sentences = verdict.verdict(table_of(methods), methods)
    sentences += [*screen.replicates_outside(methods), *screen.reuse(runs)]
    warnings = [*screen.reasons(runs), *screen.comparison_warnings(runs)]
    main = {
        str(data): error
        for data, rows in table.groupby("data", sort=False, dropna=False)
        if (error := best_settings.main_error(rows)) is not None
    }
    marks = {int(i): str(mark) for i, mark in table[render.WINNER].items()}
    rows = [{"method": i, **_row(methods[i], mark, main)} for i, mark in marks.items()]
    backends = dict.fromkeys(row["cells"]["backend"] or "?" for row in rows)
    coloured = [name for name in backends if name != "none"]
    return {
        "answer": [line.partition(": ")[::2] for line in answer.findings(methods)],
        "next": answer.following(methods, places),
        "verdict": sentences,
        "warnings": warnings,
        "columns": _columns(table, {error[0] for error in main.values()}),
        "rows": rows,
        "axes": _axes(rows),
        "errors": {data: list(error) for data, error in main.items()},
        "colours": {name: i % len(LIGHT) for i, name in enumerate(coloured)},
        "palette": {"light": LIGHT, "dark": DARK},
        "looks": _looks(rows),
    }


def _columns(table: Any, main: set[str]) -> list[dict[str, Any]]:
    """The columns that have a value, those of a comparison's screen marked ``short``. Numbers that
    say little without those of the truth and of no motion are left to ``rbtm-bench table``."""
    inner = {f"{key}_{end}" for key in main for end in ("q1", "q3", "worst", "unperturbed")}
    skipped = {render.WINNER, "run", "dataset", "seconds", "reason", *inner, *judged(table)}
    columns = []
    for key in table:
        values = [v for v in table[key] if not render.is_empty(v)]
        if key in skipped or not values or str(key).endswith(tuple(REFERENCES)):
            continue
        known = KNOWN.get(key)
        same = len(values) == len(table) and len(set(map(str, values))) == 1
        columns.append(
            {
                "key": key,
                "name": (known and known.short) or str(key),
                "unit": known.plain_unit if known else "",
                "about": known.about if known else "",
                "number": all(map(render.is_numeric_cell, values)),
                "less": bool(known and known.less_is_better),
                "short": key in (*NAMES, *render.SHORT) and (not same or key in ("backend", *main)),
                "main": key in main,
            }
        )
    leading = {COST: 2} | {key: 1 for key in main}
    return sorted(columns, key=lambda c: 0 if c["key"] in NAMES else leading.get(c["key"], 3))


def _row(method: MethodRuns, mark: str, main: dict[str, Any]) -> dict[str, Any]:
    """A method: its cells, its runs' values of the main error, the settings that axes may take."""
    shown = representative(method)
    key = main.get(str(method.row["data"]), ("",))[0]
    values = [v for v in (value_of(run, key) for run in counted(method.runs)) if v is not None]
    failed = [run for run in method.runs if not run.done]
    reasons = dict.fromkeys(str(run.record.get("reason") or run.record["status"]) for run in failed)
    known = method.row["backend"] is not None  # else a folder that cannot be read
    name = f"{method.row['backend']} {verdict.label(method.row)}" if known else shown.path.name
    cells = {str(k): _cell(v) for k, v in method.row.items()}
    if len(method.runs) == 1:  # "failed" says more than "0 of 1 done"
        cells["status"] = str(shown.record.get("status"))
    return {
        "name": name,
        "best": "*" in mark,
        "control": "+" in mark,
        "cells": cells,
        "values": [_cell(v) for v in values[:DOTS]] if len(values) > 1 else [],
        "reasons": [f"{reason}" for reason in list(reasons)[:3]],
        "dead": next(filter(None, map(answer.dead_words, method.runs)), ""),
        "settings": _settings(shown),
        "shown": shown.path.resolve().name,
        "of": len(method.runs),
        "about": _about(shown),
        "again": inspection.again(shown) if shown.record.get("overrides") is not None else "",
    }


def representative(method: MethodRuns) -> Run:
    """The run that is drawn for a method: done, on the data as they are, of the lowest seed."""
    return min(method.runs, key=lambda run: (not run.done, number_of(run), labels.seed_order(run)))


def _about(run: Run) -> str:
    """What ``rbtm-bench show`` says of a run; of one that cannot be read, why."""
    if run.record.get("status") == "unreadable":
        return str(run.record.get("reason"))
    return inspection.run_text(run)


def _settings(run: Run) -> dict[str, Any]:
    known = {group: name for group, name in run.choices.items() if group != "metrics"}
    for group in PLUGIN_GROUPS:
        for key, value in run.identity.settings(group).items():
            if isinstance(value, int | float | str):
                known[f"{group}.{key}"] = _cell(value)
    return known


def _axes(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Settings that vary within a backend and selector on a data set, then what else varies;
    RBTM's own two first. A row keeps no others."""
    swept: dict[str, None] = dict.fromkeys(("selector.window", "selector.threshold"))
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        place = tuple(row["cells"].get(key) for key in ("data", "backend", "selector"))
        groups.setdefault(place, []).append(row["settings"])
    varying = {
        key
        for group in groups.values()
        for key in dict.fromkeys(k for settings in group for k in settings)
        if len({str(s[key]) for s in group if key in s}) > 1
    }
    swept = {key: None for key in swept if key in varying} | dict.fromkeys(sorted(varying))
    others = [g for g in ("backend", "selector") if len({r["settings"].get(g) for r in rows}) > 1]
    axes = [*swept, *(key for key in others if key not in swept)]
    for row in rows:
        row["settings"] = {key: row["settings"].get(key) for key in axes}
    return axes


def _looks(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """A marker and dashes for every selector, those of the figures."""
    names = {str(row["cells"]["selector"]): str(row["cells"]["selector"]) for row in rows}
    out = {}
    for name, look in looks(names).items():
        dashes = [] if look.dashes == "-" else [2.0 * part for part in look.dashes[1]]
        out[name] = {"marker": look.marker, "dashes": dashes, "filled": look.filled}
    return out


def _cell(value: Any) -> Any:
    """A value for JSON: six digits of a number, None for what is none."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


def where(paths: Sequence[Path]) -> str:
    """The paths in a command."""
    import shlex

    return shlex.join(map(str, paths))
