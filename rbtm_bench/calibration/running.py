"""One calibration: from the words of the command line to everything that was measured."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rbtm_bench.calibration import measuring
from rbtm_bench.calibration.analysis import Measured, successes
from rbtm_bench.calibration.measuring import Node, data_node
from rbtm_bench.calibration.parts import PARTS, span_of
from rbtm_bench.calibration.plan import CalibrationPlan
from rbtm_bench.calibration.sampling import GAP, Sample, draw
from rbtm_bench.calibration.shortlist import REFERENCES, Candidate
from rbtm_bench.calibration.track import Track, track_of
from rbtm_bench.calibration.trial import Place, Trials, Verdict
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.types import Array
from rbtm_bench.core.wording import shown
from rbtm_bench.engine.crew import Supervisor
from rbtm_bench.runs.plugins import is_system

if TYPE_CHECKING:
    import pandas as pd

    from rbtm_bench.runs.grid import Point

Progress = Callable[[int, int, str], None]
"""Called with what is done, what is to be done in all, and a word on what is being done."""


@dataclass(frozen=True, eq=False)
class Asked:
    """The grid taken apart: by label, the nodes of its data sets, backends and similarities."""

    data: Mapping[str, Node]
    backends: Mapping[str, Node]
    similarities: Mapping[str, Node]
    choices: Mapping[str, str]
    """By label of a backend or similarity, the member of its group."""

    def words(self, group: str, label: str) -> list[str]:
        """What chooses a backend or similarity on a command line: a label is a name, then the
        settings that differ."""
        settings = label.split(" ")[1:]
        return [f"{group}={self.choices[label]}", *(f"{group}.{word}" for word in settings)]


def asked_of(points: Sequence[Point]) -> Asked:
    """The parts of a grid, which must be its product. Raises ``ConfigError`` where they are not, or
    where a backend registers no pairs."""
    for point in points:
        if is_system(point.settings.config):
            name = point.settings.choices["backend"]
            raise ConfigError(f"backend={name} is a whole system: it registers no pairs of scans")
    groups = ("data", "backend", "similarity")
    configs = [{**p.settings.config, "data": data_node(p.settings.config)} for p in points]
    nodes: dict[str, dict[str, tuple[str, Node]]] = {group: {} for group in groups}
    for point, config in zip(points, configs, strict=True):
        for group in groups:
            name = point.settings.choices["dataset" if group == "data" else group]
            nodes[group].setdefault(_key(config[group]), (name, config[group]))
    triples = {tuple(_key(config[g]) for g in groups) for config in configs}
    if len(triples) != np.prod([len(by_key) for by_key in nodes.values()]):
        raise ConfigError(
            "a calibration takes the same backends and similarities, with the same settings, for "
            "every data set: calibrate one kind of data set at a time"
        )
    labels = {group: _labelled(list(by_key.values())) for group, by_key in nodes.items()}
    choices = {
        label: name
        for group in groups[1:]
        for label, (name, _) in zip(labels[group], nodes[group].values(), strict=True)
    }
    return Asked(labels["data"], labels["backend"], labels["similarity"], choices)


def _key(node: Any) -> str:
    return json.dumps(node, sort_keys=True, default=str)


def _labelled(named: Sequence[tuple[str, Node]]) -> dict[str, Node]:
    """The nodes by name, and by the settings in which those of one name differ."""
    out: dict[str, Node] = {}
    for name, node in named:
        alike = [_flat(other) for n, other in named if n == name]
        keys = {k: v for k, v in _flat(node).items() if len({_key(o.get(k)) for o in alike}) > 1}
        out[" ".join([name, *(f"{k}={shown(v)}" for k, v in keys.items())])] = node
    return out


def _flat(node: Node) -> Node:
    """The settings of a plug-in, or of a data set and what is done to it."""
    if "dataset" not in node:
        return node
    return {**node["dataset"], **(node["perturb"] or {}), "deskew": node["deskew"]}


def measure(
    asked: Asked, plan: CalibrationPlan, crew: Sequence[Supervisor], pin: bool, progress: Progress
) -> tuple[Measured, list[Sample]]:
    """Draw the pairs of every data set, score and register them. The crew must be idle."""
    for node in asked.data.values():
        for similarity in asked.similarities.values():
            crew[0].call(measuring.check_similarity, node, similarity, pin=pin)
    samples = [draw(_track(node, progress), plan) for node in asked.data.values()]
    work = _Work(samples, asked, progress)
    outcomes: dict[str, list[pd.DataFrame]] = {name: [] for name in asked.backends}
    scores: dict[str, list[Array]] = {name: [] for name in asked.similarities}
    offered: dict[str, list[Array]] = {name: [] for name in asked.similarities}
    for node, sample in zip(asked.data.values(), samples, strict=True):
        for name, similarity in asked.similarities.items():
            on_pairs, on_windows = _scores(crew, node, similarity, sample, pin, work.saying(name))
            scores[name].append(on_pairs)
            offered[name].append(on_windows)
        for name, backend in asked.backends.items():
            done = work.saying(name)
            outcomes[name].append(measuring.register(crew, node, backend, sample, pin, done))
    costs = _costs(asked, crew, pin)
    pairs, windows = _together(samples)
    return (
        Measured(
            pairs,
            {name: _judged(tables, plan) for name, tables in outcomes.items()},
            {name: np.concatenate(parts) for name, parts in scores.items()},
            windows,
            {name: np.concatenate(parts) for name, parts in offered.items()},
            costs,
        ),
        samples,
    )


def run_trials(
    points: Sequence[Point],
    asked: Asked,
    plan: CalibrationPlan,
    samples: Sequence[Sample],
    candidates: Mapping[str, Sequence[Candidate]],
    out: Path,
    extra_dirs: tuple[Path, ...],
    crew: Sequence[Supervisor],
    progress: Progress,
) -> dict[str, Verdict]:
    """What is run of the references and candidates, by backend; nothing without replicates."""
    if not plan.replicates:
        return {}
    similarities = {name: asked.words("similarity", name) for name in asked.similarities}
    verdicts = {}
    for backend, node in asked.backends.items():
        places = []
        for data, sample in zip(asked.data.values(), samples, strict=True):
            mine = next(
                p.settings
                for p in points
                if data_node(p.settings.config) == data and p.settings.config["backend"] == node
            )
            by = data["perturb"] or {}
            first, every = by.get("first_scan", 0), by.get("every_scan", 1)
            spans = [span_of(sample.part, number) for number in range(len(PARTS))]
            (a, b), (c, d) = [(first + every * s, first + every * e) for s, e in spans]
            places.append(Place(mine.overrides, (a, b), (c, d), sample.of_wheels))

        def advance(word: str, done: int, total: int, who: str = backend) -> None:
            progress(done, total, f"{who}: {word}")

        trials = Trials(places, plan.replicates, out, extra_dirs, crew, advance)
        asked_for = [*REFERENCES, *candidates[backend]]
        verdicts[backend] = trials.verdict(backend, asked_for, similarities)
    return verdicts


def _judged(tables: Sequence[pd.DataFrame], plan: CalibrationPlan) -> pd.DataFrame:
    import pandas as pd

    outcome = pd.concat(tables, ignore_index=True)
    return outcome.assign(success=successes(outcome, plan.within))


def _track(node: Node, progress: Progress) -> Track:
    return track_of(
        measuring.opened(node), lambda done, total: progress(done, total, "reading scans")
    )


class _Work:
    """How much of all scores and registrations is done."""

    def __init__(self, samples: Sequence[Sample], asked: Asked, progress: Progress) -> None:
        pairs = sum(len(sample.rows) for sample in samples)
        self.total = pairs * len(asked.backends)
        for sample in samples:
            scored = sample.rows["source"].nunique() + (
                0 if _same(sample) else sample.windows["source"].nunique()
            )
            self.total += scored * len(asked.similarities)
        self.done, self._progress = 0, progress

    def saying(self, name: str) -> Callable[[int], None]:
        def more(count: int) -> None:
            self.done += count
            self._progress(self.done, self.total, name)

        self._progress(self.done, self.total, name)
        return more


def _same(sample: Sample) -> bool:
    """True if the windows offer nothing but the sampled pairs."""
    return sample.conditions["truth"] != "relations"


def _scores(
    crew: Sequence[Supervisor],
    data: Node,
    similarity: Node,
    sample: Sample,
    pin: bool,
    done: Callable[[int], None],
) -> tuple[Array, Array]:
    """The scores of the pairs, and of what windows offer."""
    target, source = (sample.rows[c].to_numpy() for c in ("target", "source"))
    on_pairs = measuring.score(crew, data, similarity, target, source, sample.guess, pin, done)
    if _same(sample):
        return on_pairs, on_pairs[(sample.rows["kind"] == GAP).to_numpy()]
    target, source = (sample.windows[c].to_numpy() for c in ("target", "source"))
    windows = measuring.score(
        crew, data, similarity, target, source, sample.window_guess, pin, done
    )
    return on_pairs, windows


def _costs(asked: Asked, crew: Sequence[Supervisor], pin: bool) -> dict[str, tuple[float, float]]:
    """Seconds a descriptor and a pair's score on the first data set, by similarity; while nothing
    else of ours runs."""
    node = next(iter(asked.data.values()))
    return {
        name: crew[0].call(measuring.cost_of, node, similarity, pin=pin)
        for name, similarity in asked.similarities.items()
    }


def _together(samples: Sequence[Sample]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Pairs and windows of all data sets; clusters of different ones differ."""
    import pandas as pd

    pairs, windows, first = [], [], 0
    for number, sample in enumerate(samples):
        rows = sample.rows.assign(data=number, cluster=sample.rows["cluster"] + first)
        first = int(rows["cluster"].max()) + 1
        pairs.append(rows)
        windows.append(sample.windows.assign(data=number))
    return pd.concat(pairs, ignore_index=True), pd.concat(windows, ignore_index=True)
