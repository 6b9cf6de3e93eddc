"""What holds for every metric family, present and future."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hydra.utils import instantiate

import rbtm_bench.metrics
from rbtm_bench.core.columns import KNOWN, REFERENCES
from rbtm_bench.core.columns import family as family_of
from rbtm_bench.core.errors import DataError
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.datasets.base import Relations
from rbtm_bench.metrics.base import Metric, ScanMetric
from rbtm_bench.metrics.map_quality import MapQuality
from rbtm_bench.metrics.summary import COLUMNS
from rbtm_bench.runs.settings import compose_settings

ROOT = Path(__file__).resolve().parents[2]


def families() -> list[type[Metric]]:
    """Every metric class in rbtm_bench.metrics."""
    classes = []
    for module in pkgutil.iter_modules(rbtm_bench.metrics.__path__, "rbtm_bench.metrics."):
        for item in vars(importlib.import_module(module.name)).values():
            if isinstance(item, type) and issubclass(item, Metric) and not inspect.isabstract(item):
                classes.append(item)
    return classes


every_family = pytest.mark.parametrize("family", families(), ids=lambda family: family.__name__)


def test_there_are_families_and_no_key_is_used_twice():
    keys = [key for family in families() for key in family.columns]
    assert len(families()) == 6
    assert len(keys) == len(set(keys)) == 45
    assert not set(keys) & set(COLUMNS)


@every_family
def test_nothing_known_gives_none_for_every_key(family, planar):
    estimate = planar([(0, 0, 0), (1, 0, 0)])
    unknown = planar([(np.nan, 0, 0)] * 2)
    unknown.T_world_scan[:] = np.nan
    for truth in (None, unknown):
        values = family().evaluate(estimate, truth, None)
        assert list(values) == list(family.columns)
        assert set(values.values()) == {None}


@every_family
@pytest.mark.parametrize("poses", [0, 1])
def test_too_few_poses_give_none(family, planar, poses):
    path = planar([(0, 0, 0)] * poses)
    values = family().evaluate(path, path, None)
    assert list(values) == list(family.columns)
    assert set(values.values()) == {None}


@every_family
def test_values_are_plain_numbers_in_the_order_of_the_columns(family, wander):
    truth, estimate = wander(10, 1), wander(10, 2)
    known = Relations(truth.stamps[:3], truth.stamps[3:6], truth.T_world_scan[:3])
    values = family().evaluate(estimate, truth, known)
    assert list(values) == list(family.columns)
    for key, value in values.items():
        assert value is None or type(value) in (int, float), key
        assert value is None or np.isfinite(value), key


@every_family
def test_inputs_are_left_alone(family, wander):
    truth, estimate = wander(10, 1), wander(10, 2)
    known = Relations(truth.stamps[:3], truth.stamps[3:6], truth.T_world_scan[:3].copy())
    before = [a.copy() for a in (truth.T_world_scan, estimate.T_world_scan, known.T_start_end)]
    family().evaluate(estimate, truth, known)
    after = [truth.T_world_scan, estimate.T_world_scan, known.T_start_end]
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


def test_every_number_has_a_family_that_computes_it():
    computed = {**COLUMNS, **{k: c for family in families() for k, c in family.columns.items()}}
    looped = {**family_of("loops"), **family_of("looped")}  # by runs.looped, with the families
    assert not computed.keys() & looped.keys()
    assert {**computed, **looped} == KNOWN


@pytest.mark.parametrize("name", ["final_pose.FinalPose", "ape.Ape", "rpe.Rpe"])
def test_truth_that_does_not_fit_is_refused(name, planar):
    module, family = name.split(".")
    metric = getattr(importlib.import_module(f"rbtm_bench.metrics.{module}"), family)()
    estimate = planar([(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    with pytest.raises(DataError, match="truth has 2 poses and the estimate 3"):
        metric.evaluate(estimate, planar([(0, 0, 0), (1, 0, 0)]), None)
    for fault in (1.1 * np.eye(3), np.diag([1.0, 1.0, -1.0])):
        truth = planar([(np.nan, 0, 0), (1, 0, 0), (2, 0, 0)])
        truth.T_world_scan[2, :3, :3] = fault
        with pytest.raises(DataError, match="pose 2 of the truth is not a rigid motion"):
            metric.evaluate(estimate, truth, None)


@pytest.mark.parametrize("name", ["default", "maps"])
def test_configs_build_every_family(name):
    """The default all that need no scans, maps the others as well."""
    built = instantiate(compose_settings([f"metrics={name}"]).config["metrics"])
    expected = {f for f in families() if name == "maps" or not issubclass(f, ScanMetric)}
    assert {type(metric) for metric in built.values()} == expected
    # The file states the defaults of the classes, so that both ways in give the same numbers.
    for metric in built.values():
        assert vars(metric) == vars(type(metric)())


def test_map_quality_comes_with_the_truth_and_no_motion():
    """For every trajectory of reference each number that it has of the estimate."""
    keys = set(MapQuality.columns)
    own = {key for key in keys if not key.endswith(tuple(REFERENCES))}
    assert keys == own | {key + end for key in own for end in REFERENCES}


def test_importing_the_package_loads_nothing_heavy():
    code = (
        "import sys; import rbtm_bench.metrics, rbtm_bench.core.trajectory\n"
        "from rbtm_bench.metrics import ape, cost, final_pose, kitti, relations, rpe\n"
        "import rbtm_bench.report.references\n"
        "heavy = {'evo', 'pandas', 'matplotlib', 'open3d', 'hydra', 'kiss_icp', 'numba'}\n"
        "heavy &= set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_numbers_agree_with_the_command_line_tools_of_evo(wander, tmp_path):
    from evo.tools.file_interface import load_res_file

    from rbtm_bench.metrics.ape import Ape
    from rbtm_bench.metrics.rpe import Rpe

    truth, estimate = wander(60, 1), wander(60, 2)
    stamps = 1134864645.90321 + 0.2 * truth.stamps
    truth, estimate = (Trajectory(stamps, t.T_world_scan) for t in (truth, estimate))
    truth.write_tum(tmp_path / "truth.tum")
    estimate.write_tum(tmp_path / "estimate.tum")
    runs = {
        "origin": ["evo_ape", "--align_origin"],
        "umeyama": ["evo_ape", "--align"],
        "translation": ["evo_rpe", "--delta", "3", "--pose_relation", "trans_part"],
        "rotation": ["evo_rpe", "--delta", "3", "--pose_relation", "angle_deg", "--all_pairs"],
    }
    processes = {}
    for name, (tool, *options) in runs.items():
        # evo writes settings into the home directory: each run gets one of its own.
        home = tmp_path / name
        home.mkdir()
        command = [Path(sys.executable).with_name(tool), "tum", "truth.tum", "estimate.tum"]
        saved = ["--save_results", str(home / "result.zip"), "--silent"]
        processes[name] = subprocess.Popen(
            [*command, *options, *saved], cwd=tmp_path, env={"HOME": str(home)}
        )
    assert {
        name: process.wait(timeout=120) for name, process in processes.items()
    } == dict.fromkeys(runs, 0)
    stats = {name: load_res_file(tmp_path / name / "result.zip").stats for name in runs}
    for align in ("origin", "umeyama"):
        ours = Ape(align).evaluate(estimate, truth)
        theirs = {
            f"ape_{statistic}_m": stats[align][statistic] for statistic in ("rmse", "mean", "max")
        }
        assert ours == pytest.approx(theirs, rel=1e-9)
    ours = Rpe(delta=3).evaluate(estimate, truth)
    assert ours["rpe_translation_rmse_m"] == pytest.approx(stats["translation"]["rmse"], rel=1e-9)
    ours = Rpe(delta=3, all_pairs=True).evaluate(estimate, truth)
    assert ours["rpe_rotation_rmse_deg"] == pytest.approx(stats["rotation"]["rmse"], rel=1e-6)
