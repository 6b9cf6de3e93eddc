"""Words for titles, legends and file names: what a run is, and what tells runs apart."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rbtm_bench.plots import style
from rbtm_bench.report import best_settings
from rbtm_bench.report.names import in_sentence
from rbtm_bench.runs.stored import Run, is_number

LARGE = 10_000
"""mm (m) from which on m (km) are the better unit."""

UNITS = {"window": "scans", "gap": "scans", "threshold": "no unit", "distance": "m"}
"""Of a setting by its name's last word, where that is not the unit itself."""
AXES = {"threshold": "similarity threshold Th"}

FOLLOWS_PATH = ("relations", "poses")
"""Settings that change with the data set's path and tell nothing more."""


def choice(run: Run, group: str) -> str:
    """The chosen member of a config group, such as "rbtm" for the selector."""
    return str((run.record.get("choices") or {}).get(group, "?"))


def is_system(run: Run) -> bool:
    """Whether the backend was a whole system, without a selector or anything that goes with it."""
    return choice(run, "selector") == "none"


def section(run: Run, group: str) -> dict[str, Any]:
    """The settings of a group; empty if it has none."""
    return run.section(group)


def numbers(run: Run, group: str) -> dict[str, float]:
    """The settings of a group that are finite numbers, seeds aside."""
    return {
        key: float(item)
        for key, item in run.identity.settings(group).items()
        if isinstance(item, int | float) and not isinstance(item, bool) and math.isfinite(item)
    }


def axis(setting: str) -> str:
    """An axis label with its unit: "keyframe angle (deg)", "window (scans)"."""
    *words, last = setting.rpartition(".")[2].split("_")
    if words and last in ("deg", "m", "s", "mm", "hz"):
        return f"{' '.join(words)} ({last})"
    name = AXES.get(setting, " ".join([*words, last]))
    return f"{name} ({UNITS[last]})" if last in UNITS else name


def folder_name(run: Run) -> str:
    """The name of the run's folder, also for the path "."."""
    return run.path.resolve().name


def stems(runs: Sequence[Run]) -> dict[Run, str]:
    """A file name for every run: its folder's, with the parents' where two are alike."""
    parts = {run: run.path.resolve().parts for run in runs}
    out: dict[Run, str] = {}
    depth = 1
    while len(out) < len(runs):
        names = {
            run: "-".join(part.strip("/\\:") for part in parts[run][-depth:])
            for run in runs
            if run not in out
        }
        counts = Counter([*names.values(), *out.values()])
        last = all(depth >= len(parts[run]) for run in names)
        out.update({run: name for run, name in names.items() if counts[name] == 1 or last})
        depth += 1
    return out


def seed_order(run: Run) -> float:
    """For sorting by seed; runs without one last."""
    seed = run.record.get("seed")
    return float(seed) if isinstance(seed, int | float) else math.inf


def word(run: Run, group: str) -> str:
    """The readable name of the chosen member of a group."""
    return style.names().of(group, choice(run, group))


def member(group: str, name: str) -> str:
    """A member's readable name within a sentence."""
    return in_sentence(style.names().of(group, name))


def data_key(run: Run) -> str:
    """Equal for runs on the same data set, whatever their seed."""
    return run.identity.dataset


def key_of(run: Run, groups: Sequence[str]) -> str:
    """Equal for runs with the same choices and settings of these groups, seeds aside."""
    return run.identity.part(*groups)


def method(run: Run) -> str:
    """A single run's strategy with its settings: "RBTM (window 64, Th 0.8)"."""
    own = run.section("selector")
    known = [key for key in style.names().groups["setting"] if is_number(own.get(key))]
    label = " ".join(f"{key}={own[key]:.3g}" for key in known)
    return style.names().method({"selector": choice(run, "selector"), "settings": label})


def title(run: Run) -> str:
    """What a figure of one run shows: data set, backend, strategy, seed."""
    words = [style.names().data_of(run), word(run, "backend"), method(run)]
    return ", ".join([*words, *seed_words(run)])


def seed_words(run: Run) -> list[str]:
    """["seed 3"], or nothing for a run without a seed."""
    seed = run.record.get("seed")
    return [] if seed is None else [unbroken(f"seed {seed}")]


def unbroken(text: str) -> str:
    """Text that no line break will divide."""
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def main_error(runs: Sequence[Run]) -> tuple[str, str, str] | None:
    """Key, unit and name of the first of ``best_settings.ERRORS`` that a run has."""
    for key, unit, _ in best_settings.ERRORS:
        if any(value(run, key) is not None for run in runs):
            return key, unit, in_sentence(style.names().metric(key))
    return None


def value(run: Run, key: str) -> float | None:
    """A metric, None if it is not a finite number."""
    number = run.metrics.get(key)
    if isinstance(number, bool) or not isinstance(number, int | float):
        return None
    return float(number) if math.isfinite(number) else None


def error_words(run: Run) -> str:
    """The run's main error in words: "final position error 25.9 mm"; "" if it has none."""
    error = main_error([run])
    if error is None:
        return ""
    key, unit, name = error
    return f"{name} {quantity(run.metrics[key], unit)}"


def quantity(number: float, unit: str) -> str:
    """Three digits and a unit, without exponents: "25.9 mm", "61.8 m"."""
    for small, large in (("mm", "m"), ("m", "km")):
        if unit == small and abs(number) >= LARGE:
            number, unit = number / 1000, large
    text = f"{float(f'{number:.3g}'):g}".replace("-", "\N{MINUS SIGN}")
    return f"{text}\N{DEGREE SIGN}" if unit == "deg" else unbroken(f"{text} {unit}")


def distinctions(runs: Sequence[Run], groups: Sequence[str]) -> dict[Run, list[str]]:
    """For every run the words that tell it from the others by these groups of its config."""
    out: dict[Run, list[str]] = {run: [] for run in runs}
    for group in groups:
        settings = varying(runs, group)
        having = {r for r in runs if not (is_system(r) and choice(r, group) == "none")}
        many = len({choice(run, group) for run in having}) > 1
        for run in runs:
            out[run] += [f"{group} {choice(run, group)}"] if many and run in having else []
            out[run] += settings[run]
    return out


def varying(runs: Sequence[Run], group: str, skip: tuple[str, ...] = ()) -> dict[Run, list[str]]:
    """For every run its settings of a group that runs with the same choice do not share."""
    members: dict[str, dict[Run, dict[str, Any]]] = {}
    for run in runs:
        members.setdefault(choice(run, group), {})[run] = run.identity.settings(group)
    out = {}
    for flats in members.values():
        known = dict.fromkeys(key for flat in flats.values() for key in flat if key not in skip)
        keys = [k for k in known if len({json.dumps(f.get(k)) for f in flats.values()}) > 1]
        if group == "dataset" and "path" in keys:
            keys = [key for key in keys if key not in FOLLOWS_PATH]
        for run, flat in flats.items():
            out[run] = [_setting(key, flat[key]) for key in keys if key in flat]
    return out


def _setting(key: str, item: Any) -> str:
    return _path_stem(item) if key == "path" else f"{key.rpartition('.')[2]}={item}"


def _path_stem(path: Any) -> str:
    """ "aces" of ".../aces.clf.gz"."""
    name = Path(str(path)).name
    return name.split(".")[0] or name
