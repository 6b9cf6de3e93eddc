"""Replicates as runs: the same draws for every method, and the unperturbed run as it was."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from sweep_helpers import call, record_of

from rbtm_bench.core.columns import is_cost
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.runs import assembly, experiment, replicate, stored
from rbtm_bench.runs.declared import PERTURBATION
from rbtm_bench.runs.evaluation import COMMON
from rbtm_bench.runs.grid import make_points
from rbtm_bench.runs.settings import Settings, compose_settings
from rbtm_bench.runs.workbench import Workbench

SHORT = ["dataset.scans=24", "dataset.beams=181", "pictures=false"]


def settings(*words: str) -> Settings:
    return compose_settings([*SHORT, *words])


def metrics_of(folder: Path) -> dict[str, object]:
    values = json.loads((folder / "metrics.json").read_text())
    return {k: v for k, v in values.items() if not is_cost(k)}


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two backends, two replicates and the run on the data as they are."""
    out = tmp_path_factory.mktemp("replicates") / "c"
    words = ["backend=plicp,open3d_p2p", "selector=keyframe,rbtm", "selector.window=4", *SHORT]
    words += ["controls=none"]
    code, _, _ = call("compare", *words, "replicates=2", f"out={out}", "-j", "1")
    assert code == 0
    return out


def test_without_replicates_nothing_changes(compared: Path, tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    experiment.run(settings("backend=plicp", "selector=keyframe"), plain)
    as_it_is = compared / "plicp-keyframe-replicate=0"
    same = ("trajectory.tum", "ground_truth.tum")
    assert all((plain / f).read_bytes() == (as_it_is / f).read_bytes() for f in same)
    assert metrics_of(plain) == metrics_of(as_it_is) and record_of(plain)["replicate"] is None
    ours = [stored.read_run(folder) for folder in (plain, as_it_is)]
    assert ours[0].identity.run == ours[1].identity.run
    assert (as_it_is / COMMON).is_file() and not (plain / COMMON).exists()


def test_every_method_gets_the_same_draws(compared: Path) -> None:
    records = {folder.name: record_of(folder) for folder in compared.glob("*-replicate=*")}
    assert len(records) == 12
    for number in (1, 2):
        drawn = {k: r["replicate"] for k, r in records.items() if k.endswith(f"={number}")}
        prints = {records[name]["dataset_fingerprint"] for name in drawn}
        data = [{k: v for k, v in d.items() if k != "settings"} for d in drawn.values()]
        assert len(drawn) == 4 and len(prints) == 1 and all(d == data[0] for d in data)
        radii = {d["settings"]["backend.max_correspondence_distance"] for d in drawn.values()}
        assert len(radii) == 1 and 0.27 <= radii.pop() <= 0.33
        rbtm = drawn[f"plicp-rbtm-replicate={number}"]["settings"]
        assert 0.69 <= rbtm["selector.threshold"] <= 0.71 != rbtm["selector.threshold"]
        assert "selector.distance" in drawn[f"plicp-keyframe-replicate={number}"]["settings"]
    numbers = {record["replicate"]["number"] for record in records.values() if record["replicate"]}
    assert numbers == {1, 2}


def test_a_replicate_is_another_run_of_the_same_way(compared: Path) -> None:
    runs = [stored.read_run(compared / f"plicp-rbtm-replicate={n}") for n in range(3)]
    assert len({run.method for run in runs}) == 1 == len({run.way for run in runs})
    assert len({run.identity.run for run in runs}) == 3
    assert {run.section("selector")["threshold"] for run in runs} == {0.7}  # as asked for
    stamps = [Trajectory.read_tum(run.path / "trajectory.tum").stamps for run in runs]
    firsts = [(run.record["replicate"] or {}).get("first_scan", 0) for run in runs]
    assert [len(s) for s in stamps] == [24 - first for first in firsts]
    assert len({run.record["trajectory_sha256"] for run in runs}) == 3


def test_replicates_that_are_done_are_not_done_again(compared: Path) -> None:
    folder = compared / "plicp-rbtm-replicate=2"
    before = record_of(folder)["finished"], (compared / "plicp-rbtm-replicate=1").stat().st_mtime
    (compared / "plicp-keyframe-replicate=1" / "metrics.json").unlink()
    code, _, error = call("compare", "--resume", str(compared), "-j", "1")
    assert code == 0 and "11 of 12 runs were done before" in error
    assert before[0] == record_of(folder)["finished"]


def test_shared_work_gives_the_same_bits(tmp_path: Path) -> None:
    bench = Workbench()
    for number in (1, 0, 2, 1):
        one = settings("selector=rbtm", f"replicate={number}", "overwrite=true")
        experiment.run(one, tmp_path / "alone")
        experiment.run(one, tmp_path / "shared", bench=bench)
        files = [tmp_path / f / "trajectory.tum" for f in ("alone", "shared")]
        assert files[0].read_bytes() == files[1].read_bytes()


def test_a_sweep_makes_them_too(tmp_path: Path) -> None:
    out = tmp_path / "s"
    words = ["backend=none", "selector=previous,keyframe", "replicates=2", *SHORT]
    assert call("sweep", *words, f"out={out}")[0] == 0
    numbers = [(record_of(out / str(i))["replicate"] or {}).get("number", 0) for i in range(6)]
    assert numbers == [0, 0, 1, 1, 2, 2]


def test_run_makes_the_one_that_is_named(tmp_path: Path) -> None:
    words = ["backend=none", "selector=previous", "replicates=5", *SHORT]
    assert call("run", *words, f"out={tmp_path / 'a'}")[0] == 0
    assert record_of(tmp_path / "a")["replicate"] is None
    assert call("run", *words, "replicate=3", f"out={tmp_path / 'b'}")[0] == 0
    assert record_of(tmp_path / "b")["replicate"]["number"] == 3


def test_points_are_in_the_order_of_their_data(tmp_path: Path) -> None:
    words = ["backend=none,plicp", "selector=previous,rbtm,random_gap", "replicates=2", *SHORT]
    points, notes = make_points(words)
    order = [point.settings.config["replicate"] for point in points if point.gaps_of is None]
    assert order == [0] * 4 + [1] * 4 + [2] * 4 and not notes
    followed = {p.name.rpartition("=")[2]: p.gaps_of for p in points if p.gaps_of}
    assert all(name is not None and name.endswith(f"={n}") for n, name in followed.items())
    experiments = tmp_path / "experiment"
    experiments.mkdir()
    text = "# @package _global_\nreplicates: 3\n"
    experiments.joinpath("three.yaml").write_text(text)
    assert len(make_points(["+experiment=three", "backend=none"], (tmp_path,))[0]) == 4


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["replicates=3", "replicate=1"], "replicates=3 makes all of them"),
        (["replicates=0"], "replicates=0"),
        (["replicates=two"], "replicates=two"),
        (["replicate=-1"], "replicate=-1"),
        (["perturbation.ranges=0.5"], "perturbation"),
    ],
)
def test_what_makes_no_replicates_is_refused(words: list[str], reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        make_points(words)


def test_runs_under_other_perturbations_are_of_another_way() -> None:
    usual, other = settings("replicate=1"), settings("replicate=1", "perturbation.start_scans=3")
    assert usual.config["perturbation"] == PERTURBATION
    assert usual.identity.way == settings().identity.way != other.identity.way
    assert usual.identity.run != settings("replicate=2").identity.run
    assert settings("replicate=1", "seed=1", "dataset.seed=0").identity.run != usual.identity.run


def test_nuisance_settings_stay_within_bounds_and_what_is_none_is_left() -> None:
    low = settings("selector.threshold=1.0", "check=gated", "check.min_fitness=0", "replicate=1")
    parts = assembly.instantiate(low)
    moved = replicate.moved_settings(low.config, parts.dataset)
    assert 0.99 <= moved["selector.threshold"] <= 1.0 and 0 <= moved["check.min_fitness"] <= 0.01
    still = settings("replicate=1", "perturbation.distances=0", "perturbation.thresholds=0")
    assert replicate.with_moved(still.config, assembly.instantiate(still).dataset) == still.config
    kinds = {key for key, _, _ in replicate.nuisances(settings("backend=kiss_icp").config)}
    assert "backend.max_correspondence_distance" in kinds
    assert "backend.map_voxel_size" not in kinds  # null: the library's own
