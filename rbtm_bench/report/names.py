"""Readable names of members, data, settings and metrics, for what goes into a paper."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rbtm_bench.core.bounded import read_yaml
from rbtm_bench.core.columns import KNOWN
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.report.frame import data_labels
from rbtm_bench.runs.stored import Run

DEFAULTS = Path(__file__).with_name("names.yaml")
NARROW = "\N{NO-BREAK SPACE}"
_OF_BACKEND = "backend."
_GAPS = re.compile(r"gaps of \S+( (window|threshold)=\S+)*")
_UNIT = re.compile(r"_(m|mm|mm2|deg|ms|s|nat)$")


def in_sentence(words: str) -> str:
    """Words within a sentence: acronyms stay."""
    return words[:1].lower() + words[1:] if words[1:2].islower() else words


@dataclass(frozen=True)
class Names:
    """Names by group ("backend", "selector", "data", "setting", "axis", "metric", ...)."""

    groups: Mapping[str, Mapping[str, str]]

    @classmethod
    def read(cls, file: Path | None = None) -> Names:
        """The defaults with the user's file over them, whose order comes first.

        Raises ``ConfigError`` for a file that is no mapping of groups to names.
        """
        groups = {key: dict(names) for key, names in read_yaml(DEFAULTS).items()}
        for group, names in (read_yaml(file) if file else {}).items():
            if group not in groups:
                raise ConfigError(f"{file}: {group}: no such group. Known: {', '.join(groups)}")
            if not isinstance(names, dict) or not all(isinstance(n, str) for n in names.values()):
                raise ConfigError(f"{file}: {group}: expected names as text, NAME: words")
            own = {str(key): name for key, name in names.items()}
            groups[group] = {**own, **{k: v for k, v in groups[group].items() if k not in own}}
        return cls(groups)

    def of(self, group: str, name: str) -> str:
        """The readable name of a member, axis, ...; without one its own."""
        return self.groups.get(group, {}).get(name) or name.rpartition(".")[2].replace("_", " ")

    def order(self, group: str, names: Iterable[str]) -> list[str]:
        """The names as the file has them, numbers by size, others at the end as they came."""
        known = list(self.groups.get(group, {}))
        unique = list(dict.fromkeys(names))
        if all(re.fullmatch(r"-?[\d.e+-]+", name) for name in unique):
            return sorted(unique, key=float)
        return sorted(unique, key=lambda n: known.index(n) if n in known else len(known))

    def metric(self, key: str) -> str:
        """A metric in words, without its unit: "Final position error"."""
        title = KNOWN[key].title if key in KNOWN else ""
        return self.groups["metric"].get(key) or title or _UNIT.sub("", key).replace("_", " ")

    def unit(self, key: str) -> str:
        """The unit of a metric, "" of shares and counts."""
        return KNOWN[key].plain_unit if key in KNOWN else ""

    def titled(self, key: str) -> str:
        """A metric with its unit: "Final position error (mm)"."""
        unit = self.unit(key)
        return f"{self.metric(key)} ({unit})" if unit else self.metric(key)

    def setting(self, word: str) -> str:
        """A setting as a label has it ("distance=0.3") in words: "0.3 m"."""
        key, equals, value = word.partition("=")
        form = self.groups["setting"].get(key.rpartition(".")[2])
        if not equals:
            return word
        return form.replace("{}", value) if form else f"{self.of('setting', key)} {value}"

    def settings(self, row: Mapping[str, Any]) -> list[str]:
        """What tells a method (its row, ``frame.MethodRuns``) from others of its selector, in
        words; what is of its backend goes with that (``backend``)."""
        if str(row.get("control") or "").startswith("matched"):
            return ["matched"]
        own = [f"{k}={row[k]:.3g}" for k in ("window", "threshold") if row.get(k) is not None]
        label = _GAPS.sub("", str(row.get("settings") or ""))
        own += [word for word in label.split() if not word.startswith(_OF_BACKEND)]
        return [self.setting(word) for word in own]

    def method(self, row: Mapping[str, Any]) -> str:
        """The strategy with its settings: "RBTM (window 10, Th 0.7)"."""
        words = [word.replace(" ", NARROW) for word in self.settings(row)]
        name = self.of("selector", str(row["selector"]))
        return f"{name} ({', '.join(words)})" if words else name

    def backend(self, row: Mapping[str, Any]) -> str:
        """The backend with the settings that tell it from others of its name."""
        label = str(row.get("settings") or "").split()
        words = [self.setting(word) for word in label if word.startswith(_OF_BACKEND)]
        return ", ".join([self.of("backend", str(row["backend"])), *words])

    def data(self, runs: Iterable[Run]) -> dict[Path, str]:
        """For every run its data in words, different where the data differ in their settings."""
        every = list(runs)
        labels = data_labels(every)
        words = {run.path: self.data_of(run) for run in every}
        of_word: dict[str, set[str]] = {}
        for run in every:
            of_word.setdefault(words[run.path], set()).add(labels[run.path])
        for run in every:
            if len(of_word[words[run.path]]) > 1 and labels[run.path]:
                words[run.path] += f" ({labels[run.path]})"
        return words

    def data_of(self, run: Run) -> str:
        """A run's data by its file's name, environment or member."""
        section = run.section("dataset")
        stem = Path(str(section.get("path") or "")).name.split(".")[0]
        return self.of("data", stem or section.get("environment") or run.choices.get("dataset", ""))
