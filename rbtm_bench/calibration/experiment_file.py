"""The advice as a config file: ``--config-dir DIR +experiment=NAME``."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

    from rbtm_bench.calibration.running import Asked
    from rbtm_bench.runs.grid import Point

ADDED = ("_target_",)


def content(out: Path, asked: Asked, points: Sequence[Point]) -> str | None:
    """The best advice of the calibration in ``out`` as YAML; None if it advises nothing.

    It names backend and similarity with all settings that the threshold was chosen with, for
    another setting makes another score, and the guess that registrations started from. Words on
    the command line still win.
    """
    import pandas as pd

    table = pd.read_csv(out / "summary.csv")
    best = table[table["best"]]
    if best.empty:
        return None
    row = best.iloc[0]
    backend, similarity = str(row["backend"]), str(row["similarity"])
    nodes = {"backend": asked.backends[backend], "similarity": asked.similarities[similarity]}
    members = {"backend": asked.choices[backend], "similarity": asked.choices[similarity]}
    record = json.loads((out / "calibration.json").read_text(encoding="utf-8"))
    lines = ["# @package _global_", *_comment(row, str(record["command"]))]
    lines += ["defaults:"]
    lines += [f"  - override /{group}: {name}" for group, name in members.items()]
    guess = str(record["samples"][0]["guess"])
    lines += [f"  - override /guess: {guess}"] if guess != "truth" else []
    lines += ["  - override /selector: rbtm", "selector:"]
    lines += [f"  threshold: {row['threshold']:g}", f"  window: {int(row['window'])}"]
    return "\n".join([*lines, *_settings(nodes)]) + "\n"


def _comment(row: pd.Series[Any], command: str) -> list[str]:
    outcome = "reaches" if row["reached"] else "does NOT reach"
    return [
        f"# Made by: {' '.join(command.split())}",
        f"# Wanted success {row['wanted']:g}: the calibration part {outcome} it "
        f"({row['calibration_success']:.3f});",
        f"# on the reported part {_reported(row)}.",
    ]


def _reported(row: pd.Series[Any]) -> str:
    if math.isnan(row["reported_success"]):
        return "it is not known"
    low, high = row["reported_success_low"], row["reported_success_high"]
    return f"{row['reported_success']:.3f} [{low:.3f}, {high:.3f}]"


def _settings(nodes: dict[str, dict[str, Any]]) -> list[str]:
    import yaml

    plain = {
        group: {k: v for k, v in node.items() if k not in ADDED} for group, node in nodes.items()
    }
    return yaml.safe_dump(plain, sort_keys=False).splitlines()
