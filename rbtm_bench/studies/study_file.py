"""A study as a file: data, ways, knobs and values, what chooses, what is shown.

``configs/study/NAME.yaml``, or a file of one's own (docs/studies.md). Whatever is wrong with it is
one line: file, key, what is expected.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge, Len
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from rbtm_bench.core.columns import KNOWN
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.wording import suggestion
from rbtm_bench.runs.settings import config_dir

LIKE = ("keyframe", "fixed_gap", "shifted_gap")
"""Selectors that can be made from a finished run, as far back as it (``runs.controls``)."""
STATUS = Literal["seen", "held out"]
OTHERS, NOWHERE = "others", "nowhere"
NAME = re.compile(r"[A-Za-z0-9][\w.+-]*", re.ASCII)
FILE = "study.yaml"
"""What a study's folder calls its file."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


Words = Annotated[list[str], Field(default_factory=list)]
Values = Annotated[list[float | int | str], Len(1)]


class Data(_Part):
    """A data set: overrides, and whether whoever made methods or defaults had looked at it."""

    words: Annotated[list[str], Len(1)]
    status: STATUS = "seen"


class Knob(_Part):
    """A setting and the values that are tried. ``labels`` are what figures call them."""

    key: str
    values: Values
    labels: list[str] | None = None

    def label(self, k: int) -> str:
        return self.labels[k] if self.labels else f"{self.values[k]:g}"


class Way(_Part):
    """A way to choose the model scan: ``words`` with the ``values`` of one ``key`` of its own; or
    ``selector``, as far back as every try of the way that it is ``like``. A ``reference`` is a
    baseline or a bound, with one try."""

    words: Words
    key: str | None = None
    values: list[float | int | str] | None = None
    like: str | None = None
    selector: Literal["keyframe", "fixed_gap", "shifted_gap"] | None = None
    reference: bool = False
    note: str = ""


class Study(_Part):
    """The whole file. ``tuned`` is what every way may tune beside its own key; a way whose own key
    is that one has its own values of it instead. ``chosen_on``: "others" (leave one data set out),
    "nowhere" (every way has one try), or seeds. ``shown``: seeds, or None with ``replicates``."""

    title: str
    question: str
    words: Words
    data: Annotated[dict[str, Data], Len(1)]
    axes: Annotated[dict[str, Knob], Field(default_factory=dict, max_length=3)]
    backends: Annotated[list[str], Len(1)]
    tuned: Knob | None = None
    ways: Annotated[dict[str, Way], Len(1)]
    ours: list[str]
    metric: str
    chosen_on: Literal["others", "nowhere"] | list[Annotated[int, Ge(0)]] = "others"
    shown: list[Annotated[int, Ge(0)]] | None = None
    replicates: Annotated[int, Ge(1)] | None = None
    quick: Annotated[dict[str, Any], Field(default_factory=dict)]

    def knobs(self, way: Way) -> dict[str, list[float | int | str]]:
        """What a way tunes (or the one that it is like), and the values."""
        way = self.ways[way.like] if way.like else way
        shared = {self.tuned.key: self.tuned.values} if self.tuned and not way.reference else {}
        return shared | ({way.key: way.values or []} if way.key else {})

    def tries(self, way: Way) -> list[dict[str, Any]]:
        """The settings of each try: every value of ``tuned`` with every value of its own."""
        knobs = self.knobs(way)
        return [dict(zip(knobs, v, strict=True)) for v in itertools.product(*knobs.values())]

    def cells(self) -> Iterator[tuple[str, str, tuple[int, ...], list[str]]]:
        """Every data set at every place of the axes: its name, the data set's, which value of
        each axis, overrides."""
        for name, data in self.data.items():
            for at in itertools.product(*(range(len(a.values)) for a in self.axes.values())):
                axes = list(zip(self.axes.items(), at, strict=True))
                label = " ".join([name, *(f"{key}={axis.label(k)}" for (key, axis), k in axes)])
                words = [f"{axis.key}={axis.values[k]}" for (_, axis), k in axes]
                yield label, name, at, [*data.words, *words]


def load(name: str, quick: bool, words: list[str]) -> Study:
    """The study of a name, a file, or a folder that one was begun in; with ``quick`` what its
    ``quick`` says instead; ``words`` are added to all runs. Raises ``ConfigError``."""
    path = _file(name)
    try:
        import yaml

        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        problem = " ".join(str(error).split())
        raise ConfigError(f"{path}: not readable as YAML: {problem}") from None
    if not isinstance(content, dict):
        raise ConfigError(
            f"{path}: expected a study (docs/studies.md), got {type(content).__name__}"
        )
    content = _in_full(content)
    if quick:
        content |= content.get("quick") or {}
    try:
        study = Study.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"{path}: {key}: {_expected(first)}") from None
    _check(study, path)
    return study.model_copy(update={"words": [*study.words, *words]})


def _file(name: str) -> Path:
    path = Path(name)
    if path.is_dir() and (path / FILE).is_file():
        return path / FILE
    if path.suffix in (".yaml", ".yml") or "/" in name:
        if not path.is_file():
            raise ConfigError(f"{name}: no such file: expected a study's YAML, or a name")
        return path
    shipped = config_dir() / "study" / f"{name}.yaml"
    if not shipped.is_file():
        raise ConfigError(f"study {name}: no such study.{suggestion(name, names())}")
    return shipped


def names() -> list[str]:
    """The studies that are shipped."""
    return sorted(file.stem for file in (config_dir() / "study").glob("*.yaml"))


def _in_full(content: dict[str, Any]) -> dict[str, Any]:
    """The same with every list of words that was written as one line taken apart."""

    def listed(node: Any) -> Any:
        return node.split() if isinstance(node, str) else node

    def part(node: Any) -> Any:
        node = {"words": node} if isinstance(node, str) else node
        return (
            {**node, "words": listed(node.get("words", []))} if isinstance(node, Mapping) else node
        )

    out = {**content, "words": listed(content.get("words", []))}
    for key in ("data", "ways"):
        if isinstance(content.get(key), Mapping):
            out[key] = {str(name): part(node) for name, node in content[key].items()}
    if isinstance(content.get("quick"), dict):
        quick = content["quick"]
        full = _in_full(quick)
        out["quick"] = {key: full[key] for key in quick}
    return out


def _expected(error: Any) -> str:
    if error["type"] == "missing":
        return "missing"
    if error["type"] == "extra_forbidden":
        return f"no such key. Known: {', '.join(Study.model_fields)} (docs/studies.md)"
    return f"{error['msg'][0].lower()}{error['msg'][1:]}, got {error['input']!r}"


def _check(study: Study, path: Path) -> None:
    """What the types do not say."""

    def refuse(key: str, expected: str) -> None:
        raise ConfigError(f"{path}: {key}: {expected}")

    if study.metric not in KNOWN:
        refuse("metric", f"{study.metric}: no such column.{suggestion(study.metric, list(KNOWN))}")
    if (study.shown is None) == (study.replicates is None):
        refuse("shown", "expected either a list of seeds, or replicates: N")
    if isinstance(study.chosen_on, list):
        twice = sorted(set(study.chosen_on) & set(study.shown or []))
        if twice or study.shown is None:
            what = (
                f"seed {twice[0]} is shown too" if twice else "seeds choose, replicates are shown"
            )
            refuse("chosen_on", f"{what}: expected other seeds than those of shown")
    if study.chosen_on == OTHERS and len(study.data) < 2:
        refuse("chosen_on", "others: there is one data set: expected several, seeds, or nowhere")
    for name in (*study.data, *study.ways):
        if not NAME.fullmatch(name):
            refuse(name, "expected a name of letters, digits, _ . + -")
    for name, way in study.ways.items():
        _check_way(study, name, way, refuse)
    for name in study.ours:
        if name not in study.ways:
            refuse("ours", f"{name}: expected some of ways: {', '.join(study.ways)}")
    for name, axis in study.axes.items():
        if axis.labels is not None and len(axis.labels) != len(axis.values):
            refuse(f"axes.{name}.labels", f"expected {len(axis.values)}, one a value")


def _check_way(study: Study, name: str, way: Way, refuse: Any) -> None:
    key = f"ways.{name}"
    if way.like is not None:
        source = study.ways.get(way.like)
        if source is None or source.like is not None:
            known = ", ".join(other for other, one in study.ways.items() if one.like is None)
            refuse(f"{key}.like", f"{way.like}: expected one of {known}")
        if way.selector is None or way.key or way.words:
            refuse(
                key, f"with like: expected selector (one of {', '.join(LIKE)}), no words, no key"
            )
        return
    if way.selector is not None:
        refuse(f"{key}.selector", "only beside like: expected words: selector=...")
    if (way.key is None) != (way.values is None):
        refuse(f"{key}.values", "expected key and values, or neither")
    if way.reference and way.key:
        refuse(f"{key}.key", "a reference has one try: expected no key")
    plain = {n: one for n, one in study.ways.items() if one.like is None and not one.reference}
    tries = {other: len(study.tries(one)) for other, one in plain.items()}
    most = max(tries.values(), default=1)
    if tries.get(name, most) != most:
        refuse(f"{key}.values", f"tries: {tries[name]}, expected {most}, as every other way has")
    if study.chosen_on == NOWHERE and most > 1:
        refuse("chosen_on", f"nowhere, but there are {most} tries: expected others or seeds")
