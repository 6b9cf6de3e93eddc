"""What makes two runs the same: one answer for grids, resume, tables and labels."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from sweep_helpers import call

from rbtm_bench.core.kinds import Kind
from rbtm_bench.report import frame
from rbtm_bench.runs import stored
from rbtm_bench.runs.grid import make_points
from rbtm_bench.runs.identity import Identity
from rbtm_bench.runs.settings import compose_settings

SHORT = ("dataset.scans=8", "dataset.beams=91")
ONLY_SEEDS = "differ only in their seed"
PLUGIN = """
from rbtm_bench.backends.none import NoRegistration

class Mine(NoRegistration):
    def __init__(self, max_correspondence_distance: float, out: float = 0.0, seed: int = 0):
        super().__init__(max_correspondence_distance)
        self.out = out
"""


@pytest.fixture
def configs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A backend whose parameters have the names of settings of ours."""
    (tmp_path / "named_out.py").write_text(PLUGIN)
    folder = tmp_path / "configs" / "backend"
    folder.mkdir(parents=True)
    folder.joinpath("mine.yaml").write_text(
        "_target_: named_out.Mine\nmax_correspondence_distance: 0.3\nout: 0.0\nseed: 0\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    return folder.parent


@pytest.mark.parametrize("parameter", ["out", "seed"])
def test_a_plugins_parameter_is_what_is_computed(
    configs: Path, tmp_path: Path, parameter: str
) -> None:
    out = tmp_path / "c"
    words = ["backend=mine", f"backend.{parameter}=0,3", "selector=previous", *SHORT]
    code, text, _ = call("compare", *words, "--config-dir", str(configs), f"out={out}")
    assert code == 0 and ONLY_SEEDS not in text
    summary = pd.read_csv(out / "summary.csv")
    assert summary["seeds"].tolist() == [1, 1]
    assert summary["settings"].tolist() == [f"backend.{parameter}={v}" for v in (0, 3)]


def test_how_runs_are_executed_makes_no_other_point(tmp_path: Path) -> None:
    words = ["backend=none", "selector=previous", *SHORT]
    code, text, error = call("compare", *words, "pairs.store=off,shared", f"out={tmp_path / 'c'}")
    assert code == 0 and len(list((tmp_path / "c").glob("*/run.json"))) == 1
    assert "merged: pairs.store is how runs are executed, not what they give" in error
    assert ONLY_SEEDS not in text
    code, text, error = call("sweep", *words, "pin=true,false", f"out={tmp_path / 's'}")
    assert code == 0 and len(list((tmp_path / "s").glob("*/run.json"))) == 1
    assert "its 2 points are one, pin=true" in error and ONLY_SEEDS not in text


def test_a_repeated_run_is_no_second_seed(tmp_path: Path) -> None:
    words = ["backend=none", "selector=previous", *SHORT]
    for name, pin in (("a", "true"), ("b", "false")):
        assert call("run", *words, f"pin={pin}", f"out={tmp_path / name}")[0] == 0
    (row,) = frame.over_seeds(stored.find_runs([tmp_path])).to_dict("records")
    assert row["seeds"] == 1


def test_points_that_cannot_differ_are_one() -> None:
    similarities = "similarity=overlap,curvature_circular,range_correlation"
    points, notes = make_points(["selector=previous,rbtm", similarities])
    assert sorted(p.settings.choices["selector"] for p in points) == ["previous", *["rbtm"] * 3]
    assert "merged: selector=previous needs no similarity: its 3 points are one" in notes
    points, notes = make_points(["selector=rbtm", "selector.keyframe_distance=0.3,0.5"])
    assert len(points) == 1 and notes
    keyframes = ["selector.content=keyframes", "selector.keyframe_distance=0.3,0.5"]
    assert len(make_points(["selector=rbtm", *keyframes])[0]) == 2


def test_kinds_of_special_settings() -> None:
    settings = compose_settings(["selector=random_gap", "selector.gaps=[1,2]", "seed=4"])
    assert settings.special == {
        "dataset.seed": Kind.SEED,
        "selector.seed": Kind.SEED,
        "selector.gaps_from": Kind.OTHER_RUN,
    }
    assert settings.identity.seed == {"dataset.seed": 4, "selector.seed": 4}
    assert settings.idle == ("similarity",)


def test_the_same_run_the_same_method_the_same_data() -> None:
    def one(*words: str):
        return compose_settings(list(words)).identity

    base = one("selector=rbtm")
    again = one("selector=rbtm", "pin=false", "pairs.memory_mb=5", "time_limit=9", "out=x")
    assert base.run == again.run
    seed = one("selector=rbtm", "seed=1")
    assert base.run != seed.run and base.method == seed.method
    other = one("selector=rbtm", "selector.window=5")
    assert base.method != other.method and base.dataset == other.dataset
    longer = one("selector=rbtm", "dataset.scans=20")
    assert base.way == longer.way and base.dataset != longer.dataset
    # a value that plug-ins take over counts where it stands again
    assert base.method != one("selector=rbtm", "registration.max_correspondence_distance=1").method


def test_a_method_s_way_leaves_out_the_data_and_its_name() -> None:
    """The choice of data set and its settings are in ``dataset``, all others in ``way``."""
    choices = {"dataset": "corridor", "backend": "p2p"}
    one = Identity({"backend.radius": 0.3}, {"dataset.scans": 8}, {}, choices)
    log = replace(one, choices={**choices, "dataset": "carmen"}, data={"dataset.path": "a.clf"})
    assert one.way == log.way and one.dataset != log.dataset and one.method != log.method
    other = replace(one, choices={**choices, "backend": "gicp"})
    wider = replace(one, what={"backend.radius": 0.5})
    assert len({one.way, other.way, wider.way}) == 3
    assert one.dataset == other.dataset == wider.dataset
    seeded = replace(one, seed={"dataset.seed": 3})
    assert one.method == seeded.method and one.run != seeded.run


def test_idle_names_are_whole_names() -> None:
    """An idle setting takes those below it along, and none whose name only begins like it."""
    config = {"selector": {"key": 1, "keys": 2, "deep": {"er": 3, "est": 4}, "deeper": 5}}
    found = Identity.of({"selector": "mine"}, config, {}, ["selector.key", "selector.deep"])
    assert found.what == {"selector.keys": 2, "selector.deeper": 5}
    assert found.choices == {"selector": "mine"}
    assert Identity.of({"selector": "mine"}, config, {}, ["selector"]).choices == {}


def test_a_list_of_similarities_is_labelled_by_its_names(tmp_path: Path) -> None:
    words = ["backend=open3d_p2p", "selector=rbtm", "controls=none", *SHORT]
    code, _, _ = call(
        "compare", *words, "similarity=overlap,curvature_circular", f"out={tmp_path / 'c'}"
    )
    assert code == 0
    summary = pd.read_csv(tmp_path / "c" / "summary.csv")
    assert sorted(summary["settings"]) == [
        "similarity=curvature_circular",
        "similarity=overlap",
    ]


def test_runs_record_what_identity_needs(tmp_path: Path) -> None:
    assert call("run", "backend=none", "selector=previous", *SHORT, f"out={tmp_path / 'r'}")[0] == 0
    record = json.loads((tmp_path / "r" / "run.json").read_text())
    assert record["special"] == {"dataset.seed": "SEED"} and record["idle"] == ["similarity"]
    run = stored.read_run(tmp_path / "r")
    words = ["backend=none", "selector=previous", *SHORT]
    assert run.identity.run == compose_settings(words).identity.run
    del run.record["special"]  # a run of before
    assert stored.Run(run.path, run.record, run.config, run.metrics).identity.run == (
        compose_settings(words).identity.run
    )
