"""The points of a comparison: what an override applies to, what coincides, what it is called."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.runs.grid import LONGEST_NAME, Point, check_values, make_points

STILL = '''
import numpy as np

from rbtm_bench.datasets.base import Dataset
from rbtm_bench.core.types import Scan


class Still(Dataset):
    """A log without anything random."""

    def __init__(self, path: str = "x", length: int = 4) -> None:
        self.length = length

    def __len__(self):
        return self.length

    def __getitem__(self, index):
        return Scan(index, 0.1 * index, np.eye(8, 3))

    def fingerprint(self):
        return "still"
'''


@pytest.fixture
def extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Configs with a data set that uses no seed."""
    (tmp_path / "still_data.py").write_text(STILL)
    configs = tmp_path / "still_configs"
    (configs / "dataset").mkdir(parents=True)
    (configs / "dataset" / "still.yaml").write_text(
        "# @package _global_\ndataset:\n  _target_: still_data.Still\n  path: x\n  length: 4\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    return configs


def points(*words: str, extra: Path | None = None) -> list[Point]:
    return make_points(list(words), (extra,) if extra else ())[0]


def names(*words: str, extra: Path | None = None) -> list[str]:
    return [point.name for point in points(*words, extra=extra)]


def notes(*words: str, extra: Path | None = None) -> list[str]:
    return make_points(list(words), (extra,) if extra else ())[1]


def mistake(*words: str) -> str:
    with pytest.raises(ConfigError) as caught:
        make_points(list(words))
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def values(found: list[Point], group: str, key: str) -> list[Any]:
    return [point.settings.config[group].get(key) for point in found]


# --- what an override applies to


def test_nothing_on_the_command_line_is_one_point() -> None:
    assert names() == ["open3d_p2p-rbtm"]


def test_a_key_applies_to_every_member_that_declares_it() -> None:
    found = points("selector=previous,oldest,rbtm", "selector.window=7", "backend=none")
    assert values(found, "selector", "window") == [None, 7, 7]


def test_lists_multiply() -> None:
    words = ("backend=none,open3d_p2p", "selector=rbtm,oldest", "selector.window=4,8", "seed=0,1")
    assert len(points(*words)) == 2 * 2 * 2 * 2


def test_a_key_of_one_member_only_multiplies_that_one() -> None:
    words = ("backend=none", "selector=fixed_gap,rbtm", "selector.gap=2,3", "selector.window=4,5")
    assert names(*words) == [
        "none-fixed_gap-gap=2",
        "none-fixed_gap-gap=3",
        "none-rbtm-window=4",
        "none-rbtm-window=5",
    ]
    assert notes(*words) == [
        "merged: selector=fixed_gap has no selector.window: its 2 points are one",
        "merged: selector=rbtm has no selector.gap: its 2 points are one",
    ]


@pytest.mark.parametrize(
    ("words", "start"),
    [
        ("selector=previous selector.window=4", "selector.window: no chosen member has"),
        (
            "selector=rbtm selector.windw=4",
            "selector.windw: no chosen member has such a setting. D",
        ),
        ("selector=previous,rbtm selector.windw=4,5", "selector.windw: no chosen member"),
        ("bakend=none", "bakend: no chosen member has such a setting. Did you mean backend?"),
        ("selector=rbtm selector.window=4,1", "selector.window=1: "),
        ("selector=previous,rbtm selector.fallback=previous,no", "selector.fallback=no: "),
        ("backend=none,nix", "backend=nix: no such backend."),
        ("backend=null", "backend=null: expected the name"),
        ("backend=[none,kiss_icp]", "backend=[none,kiss_icp]: expected the name"),
        ("+seed=1,2", "+seed=1,2: a list of values cannot be added"),
        ("out=a,b", "out=a,b: a comparison has one value of out"),
        ("selector.threshold=interval(0,1)", "selector.threshold=interval(0,1): "),
        ("dataset=carmen", "dataset.path is not set"),
        ("dataset.path=a=b", "dataset.path=a=b: cannot be read"),
        ("~check", "check: expected"),
    ],
)
def test_mistakes(words: str, start: str) -> None:
    assert mistake(*words.split()).startswith(start)


def test_additions_and_deletions() -> None:
    found = points("backend=none", "selector=rbtm", "+dataset.note=1", "~dataset.note")
    assert "note" not in found[0].settings.config["dataset"]
    found = points("backend=none,open3d_p2p", "++backend.voxel_size=0.5", "~metrics.rpe")
    assert values(found, "backend", "voxel_size") == [0.5, 0.5]
    assert all("rpe" not in point.settings.config["metrics"] for point in found)
    assert mistake("selector=rbtm", "+selector.more=1").startswith("selector.more: no such")


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("selector.window=range(3,6)", [3, 4, 5]),
        ("selector.window=choice(3,9)", [3, 9]),
        ("selector.window=4,8", [4, 8]),
        ("selector.window=sort(8,4)", [4, 8]),
    ],
)
def test_ways_to_list_values(word: str, expected: list[int]) -> None:
    assert values(points("backend=none", "selector=rbtm", word), "selector", "window") == expected


def test_members_by_a_pattern() -> None:
    found = points("backend=glob(open3d*)", "selector=previous")
    chosen = [point.settings.choices["backend"] for point in found]
    assert {"open3d_p2p", "open3d_p2plane", "open3d_gicp"} <= set(chosen)
    assert all(name.startswith("open3d") for name in chosen)


def test_lists_are_values_too() -> None:
    found = points("backend=open3d_p2p", "backend.coarse_to_fine=[4,2,1],[1]")
    assert values(found, "backend", "coarse_to_fine") == [[4, 2, 1], [1]]


PATHS = ["a b/c.clf", "x=y.clf", "one,two.clf", "(new) [1].clf", 'say "hi".clf', "ä.clf"]


def test_paths_with_unusual_characters() -> None:
    for path in PATHS:
        (point,) = points("dataset=carmen", f"dataset.path='{path}'", "selector=previous")
        assert point.settings.config["dataset"]["path"] == path
    several = ",".join(f"'{path}'" for path in PATHS)
    found = points("dataset=carmen", f"dataset.path={several}", "selector=previous")
    assert values(found, "dataset", "path") == PATHS
    safe_and_unique([point.name for point in found])


# --- what coincides


def test_points_that_coincide_are_one_and_say_so() -> None:
    words = ("backend=none", "selector=previous,rbtm", "selector.window=4,6")
    assert names(*words) == ["none-previous", "none-rbtm-window=4", "none-rbtm-window=6"]
    assert notes(*words) == [
        "merged: selector=previous has no selector.window: its 2 points are one"
    ]
    assert names("backend=none,none", "seed=1,1") == ["none-rbtm-seed=1"]
    assert len(notes("backend=none,none", "seed=1,1")) == 1


def test_seeds_that_nothing_uses_are_one_point(extra: Path) -> None:
    words = ("dataset=still", "backend=none", "selector=previous,fixed_gap", "seed=0,1,2")
    found = points(*words, extra=extra)
    assert [point.settings.choices["selector"] for point in found] == ["previous", "fixed_gap"]
    said = notes(*words, extra=extra)
    assert len(said) == 4 and all(note.startswith("merged: ") for note in said)


def test_seeds_that_the_data_set_uses_stay_apart() -> None:
    found = points("backend=none", "selector=previous", "seed=0,1,2")
    assert values(found, "dataset", "seed") == [0, 1, 2]


# --- random_gap


def test_random_gap_follows_every_rbtm_point() -> None:
    found = points("backend=none", "selector=random_gap,rbtm", "selector.window=4,8", "seed=0,1")
    by_name = {point.name: point for point in found}
    drawn = [point for point in found if point.gaps_of]
    assert len(found) == 8 and len(drawn) == 4
    for point in drawn:
        source = by_name[str(point.gaps_of)]
        assert source.settings.choices["selector"] == "rbtm"
        assert source.settings.config["seed"] == point.settings.config["seed"]
    assert {point.gaps_of for point in drawn} == {p.name for p in found if not p.gaps_of}


def test_random_gap_follows_rbtm_on_its_own_data_and_backend() -> None:
    words = ("backend=none,open3d_p2p", "dataset.environment=paper,bare")
    for point in points(*words, "selector=rbtm,random_gap"):
        if point.gaps_of:
            expected = re.sub("random_gap", "rbtm", point.name)
            assert point.gaps_of == expected


def test_seeds_of_random_gap_share_an_rbtm_run_that_uses_none(extra: Path) -> None:
    words = ("dataset=still", "backend=none", "selector=rbtm,random_gap", "seed=0,1,2")
    found = points(*words, extra=extra)
    assert [point.gaps_of for point in found] == [None, *["none-rbtm-seed=0"] * 3]
    assert values(found[1:], "selector", "seed") == [0, 1, 2]


def test_random_gap_needs_gaps_from_somewhere() -> None:
    assert mistake("selector=previous,random_gap").startswith("selector=random_gap draws its gaps")
    assert "selector=rbtm" in mistake("selector=random_gap")
    (point,) = points("selector=random_gap", "selector.gaps=[1,2]")
    assert point.gaps_of is None
    (point,) = points("selector=random_gap", "selector.gaps_from=elsewhere")
    assert point.gaps_of is None


# --- names


def safe_and_unique(found: list[str]) -> None:
    assert len(set(found)) == len(found)
    for name in found:
        assert re.fullmatch(r"[A-Za-z0-9_.=+-]+", name), name
        assert len(name) <= LONGEST_NAME + 10 and name not in (".", "..")


def test_names_are_unique_and_safe() -> None:
    safe_and_unique(
        names(
            "backend=none,open3d_p2p",
            "selector=rbtm,random_gap",
            "selector.threshold=-0.5,0.5",
            "similarity=curvature,curvature_circular",
            "backend.voxel_size=0.0,1e-3",
            "metrics.ape.align=none,origin",
        )
    )
    long = ",".join(f"'{'x' * 300}{i}'" for i in range(3))
    safe_and_unique(names("dataset=carmen", f"dataset.path={long}", "selector=previous"))


def test_names_tell_what_differs_and_no_more() -> None:
    found = names("backend=none", "selector=rbtm", "selector.threshold=0.5,0.6", "seed=7")
    assert found == ["none-rbtm-threshold=0.5", "none-rbtm-threshold=0.6"]
    assert names("similarity=curvature,curvature_circular", "backend=none") == [
        "none-rbtm-curvature",
        "none-rbtm-curvature_circular",
    ]


# --- sweeps


def test_sweeps_check_every_value_before_anything_runs() -> None:
    first = check_values(["selector.threshold=0.6,0.7", "backend=none,open3d_p2p", "seed=3"])
    assert first.config["selector"]["threshold"] == 0.6
    assert first.choices["backend"] == "none"
    for words in (
        ["selector.threshold=0.6,high"],
        ["backend=none,nix"],
        ["selector.window=range(0,3)"],
        ["seed=1,a"],
        ["selector=previous,rbtm", "selector.window=4"],
        ["selector.threshold=interval(0,1)"],
    ):
        with pytest.raises(ConfigError):
            check_values(words)
