"""Settings: every mistake is one line that names the offending word, before anything runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.wording import shown, suggestion
from rbtm_bench.runs.declared import GROUPS
from rbtm_bench.runs.plugins import locate
from rbtm_bench.runs.settings import compose_settings, config_dir, member_nodes, members

PLUGIN = """
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Optional

from annotated_types import Gt

if TYPE_CHECKING:
    from nowhere import Nothing


class Speed(Enum):
    SLOW = "slow"
    FAST = "fast"


class Mine:
    def __init__(
        self,
        rounds: Annotated[int, Gt(0)],
        gain: float = 1.0,
        model: Optional[Path] = None,
        weights: tuple[float, float] = (1.0, 1.0),
        levels: Sequence[int] = (),
        mode: Literal["auto"] | bool = "auto",
        speed: Speed = Speed.SLOW,
        untyped=None,
        anything: Any = None,
        inner: Any = None,
    ) -> None: ...

    @classmethod
    def made(cls, rounds: int) -> Mine:
        return cls(rounds)


class Open:
    def __init__(self, rounds: int = 1, **options: float) -> None: ...


@dataclass
class Point:
    x: float = 0.0


class Unchecked:
    def __init__(self, rounds: Nothing = None) -> None: ...


NUMBER = 3
"""

BROKEN = {
    "raises": "raise RuntimeError('two\\nlines')",
    "lacks": "import a_library_that_is_not_there",
    "unreadable": "def (",
}

MEMBERS = {
    "mine": "_target_: my_plugin.Mine\nrounds: 3",
    "open": "_target_: my_plugin.Open\nrounds: 3",
    "made": "_target_: my_plugin.Mine.made\nrounds: 3",
    "unchecked": "_target_: my_plugin.Unchecked\nrounds: 3",
    "incomplete": "_target_: my_plugin.Mine",
    "asks": "_target_: my_plugin.Mine\nrounds: ???",
    "number": "_target_: my_plugin.NUMBER",
    "nowhere": "_target_: not_there.at_all.Backend",
    "undotted": "_target_: Backend",
    "targetless": "rounds: 3",
    **{name: f"_target_: module_that_{name}.Backend" for name in BROKEN},
}


@pytest.fixture
def extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Somebody else's configs, with their modules importable."""
    (tmp_path / "my_plugin.py").write_text(PLUGIN)
    for name, text in BROKEN.items():
        (tmp_path / f"module_that_{name}.py").write_text(text)
    configs = tmp_path / "my_configs" / "backend"
    configs.mkdir(parents=True)
    for name, text in MEMBERS.items():
        (configs / f"{name}.yaml").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    return configs.parent


def mistake(*words: str, extra: Path | None = None) -> str:
    """The message of the one-line error that these overrides give."""
    with pytest.raises(ConfigError) as caught:
        compose_settings(list(words), (extra,) if extra else ())
    message = str(caught.value)
    assert len(message.splitlines()) == 1, message
    assert "Traceback" not in message
    return message


# --- what is right


def test_defaults_compose() -> None:
    settings = compose_settings([])
    assert list(settings.choices) == list(GROUPS)
    assert settings.choices["dataset"] == "corridor"
    assert settings.config["dataset"]["seed"] == settings.config["seed"] == 0  # resolved
    assert "hydra" not in settings.config
    assert settings.overrides == ()


def test_overrides_are_kept_as_typed() -> None:
    words = ["backend=none", "seed=3"]
    settings = compose_settings(words)
    assert settings.overrides == tuple(words)
    assert settings.choices["backend"] == "none"
    assert settings.config["dataset"]["seed"] == 3


@pytest.mark.parametrize(
    "word",
    [
        "selector.threshold=1",  # a whole number is a number
        "selector.threshold=-1",
        "dataset.path_length=1.5",
        "dataset.path_length=null",
        "~selector.window",  # the constructor has a default
        "backend.coarse_to_fine=[4,2,1]",
        "metrics.ape.align=umeyama",
        "~metrics.rpe",
        "registration.voxel_size=0.1",
        "out='a, b = c'",
    ],
)
def test_these_fit(word: str) -> None:
    compose_settings([word])


def test_settings_shared_by_groups_reach_their_plugins() -> None:
    config = compose_settings(["registration.voxel_size=0.25"]).config
    assert config["backend"]["voxel_size"] == 0.25


# --- wrong values and words


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("selector.threshold=high", "valid number"),
        ("selector.threshold=true", "valid number"),
        ("selector.threshold=nan", "a number"),
        ("selector.threshold=null", "valid number"),
        ("selector.threshold=1.5", "less than or equal to 1"),
        ("selector.window=2.5", "valid integer"),
        ("selector.window=true", "valid integer"),
        ("selector.window='3'", "valid integer"),
        ("selector.window=0", "greater than or equal to 2"),
        ("selector.window=[1]", "valid integer"),
        ("seed=a", "valid integer"),
        ("seed=1.0", "valid integer"),
        ("overwrite=3", "valid boolean"),
        ("pin=maybe", "valid boolean"),
        ("map_resolution=0", "greater than 0"),
        ("map_resolution=fine", "valid number"),
        ("out=3", "valid string; quote it"),
        ("selector.fallback=sometimes", "'previous', 'best' or 'skip'"),
        ("dataset.environment=moon", "'paper', 'bare', 'cluttered' or 'l_turn'"),
        ("dataset.path_length=long", "valid number"),
        ("metrics.ape.align=fit", "'none', 'origin' or 'umeyama'"),
        ("metrics.relations.local_s=-1", "greater than or equal to 0"),
        ("metrics.final_pose.travel_m=0", "greater than 0"),
        ("backend.coarse_to_fine=[4,two]", "valid number"),
        ("backend.coarse_to_fine=4", "valid"),
        ("backend.voxel_size=-0.1", "greater than or equal to 0"),
        ("similarity.center=1", "valid boolean"),
    ],
)
def test_a_value_of_the_wrong_type_or_range(word: str, expected: str) -> None:
    message = mistake(word)
    assert message.startswith(word.replace("'", ""))
    assert expected in message


def test_a_value_that_two_types_refuse_names_both() -> None:
    message = mistake("dataset=carmen", "dataset.path=x", "dataset.corrected=perhaps")
    assert "'auto'" in message and "boolean" in message


@pytest.mark.parametrize(
    ("word", "key", "meant"),
    [
        ("selector.windw=3", "selector.windw", "window"),
        ("dataset.enviroment=bare", "dataset.enviroment", "environment"),
        ("metrics.ape.algn=none", "metrics.ape.algn", "align"),
        ("bakend=none", "bakend", "backend"),
        ("registration.voxel=1", "registration.voxel", "voxel_size"),
        ("+selector.windw=3", "selector.windw", "window"),
        ("backend.nothing.like.it=1", "backend.nothing.like.it", ""),
    ],
)
def test_an_unknown_key(word: str, key: str, meant: str) -> None:
    message = mistake(word)
    assert message.startswith(f"{key}: no such setting.")
    assert (f"Did you mean {meant}?" in message) == bool(meant)
    assert "Known: " in message


@pytest.mark.parametrize(
    ("word", "meant"),
    [("backend=opend3d_p2p", "open3d_p2p"), ("selector=rbmt", "rbtm"), ("metrics=xyz", "")],
)
def test_an_unknown_member(word: str, meant: str) -> None:
    message = mistake(word)
    assert message.startswith(f"{word}: no such {word.partition('=')[0]}.")
    assert (f"Did you mean {meant}?" in message) == bool(meant)
    assert "Known: " in message


@pytest.mark.parametrize(
    "word", ["backend=null", "backend=3", "backend=[none,kiss_icp]", "metrics=null"]
)
def test_a_member_is_one_name(word: str) -> None:
    group = word.partition("=")[0]
    assert mistake(word) == f"{word}: expected the name of one {group}"


@pytest.mark.parametrize("word", ["dataset=[", "out=a=b", "out=it's", "a b=3", "selector.window=("])
def test_words_that_hydra_cannot_read(word: str) -> None:
    message = mistake(word)
    assert message.startswith(f"{word}: cannot be read as key=value")
    assert "quote" in message


def test_a_list_where_one_value_belongs() -> None:
    message = mistake("backend=none,kiss_icp")
    assert message.startswith("backend=none,kiss_icp: one value expected")
    assert "rbtm-bench compare" in message


def test_missing_values() -> None:
    assert mistake("dataset=carmen") == "dataset.path is not set: give it as dataset.path=<value>"
    assert "dataset.path is not set" in mistake("dataset=cloud_folder")
    assert "seed" in mistake("seed=???")
    assert "Missing mandatory value" not in mistake("dataset=carmen", "selector=previous")


@pytest.mark.parametrize("key", ["~backend", "~seed", "~pin", "~dataset"])
def test_what_cannot_be_left_out(key: str) -> None:
    assert key[1:] in mistake(key)


def test_references_to_nothing() -> None:
    assert mistake("selector.window=${nowhere}").startswith("selector.window: ")
    assert "NOT_SET_ANYWHERE" in mistake("out=${oc.env:NOT_SET_ANYWHERE}")


# --- somebody else's plug-ins


def test_members_of_an_extra_folder(extra: Path) -> None:
    ours, all_of_them = members("backend"), members("backend", (extra,))
    assert {"none", "kiss_icp", "open3d_p2p"} <= set(ours)
    assert {"mine", "open"} <= set(all_of_them) - set(ours)
    assert all_of_them == sorted(all_of_them)
    assert ours == sorted(p.stem for p in (config_dir() / "backend").glob("*.yaml"))


def test_member_nodes_show_what_is_written(extra: Path) -> None:
    nodes = member_nodes("backend", (extra,))
    assert nodes["mine"] == {"_target_": "my_plugin.Mine", "rounds": 3}
    asks = nodes["asks"]
    assert isinstance(asks, dict) and asks["rounds"] == "???"
    ours = nodes["none"]
    assert isinstance(ours, dict)
    assert ours["voxel_size"] == "${registration.voxel_size}"


def test_a_member_that_cannot_be_composed_is_an_entry_not_an_end(extra: Path) -> None:
    (extra / "backend" / "damaged.yaml").write_text("a: [1\n")
    nodes = member_nodes("backend", (extra,))
    assert isinstance(nodes["damaged"], ConfigError)
    assert isinstance(nodes["mine"], dict)


def test_a_folder_that_is_not_there() -> None:
    with pytest.raises(ConfigError, match="--config-dir nowhere: no such folder"):
        members("backend", (Path("nowhere"),))


@pytest.mark.parametrize(
    "words",
    [
        "mine",
        "mine +backend.gain=2",
        "mine +backend.model=a/b.pt",
        "mine +backend.model=null",
        "mine +backend.weights=[1,2.5]",
        "mine +backend.levels=[1,2]",
        "mine +backend.mode=true",
        "mine +backend.speed=fast",
        "mine +backend.untyped={a:1} +backend.anything=[x]",
        "mine +backend.inner={_target_:my_plugin.Point,x:1.5}",
        "open +backend.whatever=1.5",
        "made",
        "unchecked",
    ],
)
def test_annotations_of_others_that_fit(extra: Path, words: str) -> None:
    compose_settings(f"backend={words}".split(), (extra,))


@pytest.mark.parametrize(
    ("words", "start"),
    [
        ("mine backend.rounds=many", "backend.rounds=many"),
        ("mine backend.rounds=0", "backend.rounds=0"),
        ("mine +backend.gain=much", "backend.gain=much"),
        ("mine +backend.model=3", "backend.model=3"),
        ("mine +backend.weights=[1,b]", "backend.weights=[1,b]"),
        ("mine +backend.weights=[1,2,3]", "backend.weights=[1,2,3]"),
        ("mine +backend.levels=ab", "backend.levels=ab"),
        ("mine +backend.mode=1", "backend.mode=1"),
        ("mine +backend.speed=warp", "backend.speed=warp"),
        ("mine +backend.inner={_target_:my_plugin.Point,x:a}", "backend.inner.x=a"),
        ("mine +backend.inner={_target_:my_plugin.No}", "backend.inner: cannot load"),
        ("mine +backend.more=1", "backend.more: no such setting"),
        ("mine backend.round=1", "backend.round: no such setting"),
        ("made backend.rounds=x", "backend.rounds=x"),
        ("incomplete", "backend.rounds is not set: my_plugin.Mine requires it"),
        ("asks", "backend.rounds is not set"),
        ("targetless", "backend: expected a config with a _target_"),
    ],
)
def test_annotations_of_others_that_do_not_fit(extra: Path, words: str, start: str) -> None:
    assert mistake(*f"backend={words}".split(), extra=extra).startswith(start)


@pytest.mark.parametrize(
    ("member", "why"),
    [
        ("nowhere", "No module named 'not_there'"),
        ("undotted", "package.module.Class"),
        ("number", "not a class"),
        ("raises", "RuntimeError: two lines"),
        ("lacks", "No module named 'a_library_that_is_not_there'"),
        ("unreadable", "SyntaxError"),
    ],
)
def test_targets_that_cannot_be_imported(extra: Path, member: str, why: str) -> None:
    message = mistake(f"backend={member}", extra=extra)
    assert message.startswith("backend: cannot load ")
    assert why in message


def test_locate_finds_what_a_class_holds(extra: Path) -> None:
    assert callable(locate("backend", "my_plugin.Mine.made"))
    with pytest.raises(ConfigError, match=r"cannot load my_plugin\.Mine\.unmade"):
        locate("backend", "my_plugin.Mine.unmade")


# --- words


def test_suggestions() -> None:
    assert suggestion("windw", ["window", "threshold"]) == (
        " Did you mean window? Known: window, threshold"
    )
    assert suggestion("xyz", ["window"]) == " Known: window"
    assert suggestion("xyz", []) == " Known: (none)"


def test_values_are_shown_as_typed() -> None:
    words = [shown(value) for value in (None, True, 1.5, "a b", [1, False, "x"])]
    assert words == ["null", "true", "1.5", "a b", "[1,false,x]"]
