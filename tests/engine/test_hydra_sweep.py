"""What a sweep will do, found out before it begins."""

from __future__ import annotations

import pytest

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.engine.hydra_sweep import SweepPlan


def test_the_plan_names_every_job_in_hydras_order() -> None:
    plan = SweepPlan.of(["backend=none,open3d_p2p", "seed=1,2", "hydra/launcher=joblib"], ())
    assert plan.jobs == [
        ["backend=none", "seed=1"],
        ["backend=none", "seed=2"],
        ["backend=open3d_p2p", "seed=1"],
        ["backend=open3d_p2p", "seed=2"],
    ]
    assert not plan.one_process and SweepPlan.of(["seed=1"], ()).one_process
    assert {(s.choices["backend"], s.config["seed"]) for s in plan.settings} == {
        ("none", 1),
        ("open3d_p2p", 1),
        ("none", 2),
    }


@pytest.mark.parametrize(
    "word", ["hydra.sweep.dir=x", "hydra.sweep.subdir=x", "hydra/launcher=nix", "seed=1,a"]
)
def test_a_plan_that_cannot_be(word: str) -> None:
    with pytest.raises(ConfigError):
        SweepPlan.of([word], ())


CLUSTERS = ["hydra/launcher=slurm", "hydra/launcher=ray_cluster"]


@pytest.mark.parametrize("launcher", CLUSTERS)
def test_machines_of_a_cluster_share_no_file(launcher: str) -> None:
    words = ["seed=1,2", launcher]
    with pytest.raises(ConfigError, match=r"add pairs\.store=per_worker"):
        SweepPlan.of(words, ())
    for store in ("per_worker", "off"):
        assert len(SweepPlan.of([*words, f"pairs.store={store}"], ()).settings) == 2


@pytest.mark.parametrize("launcher", ["basic", "joblib", "submitit_local", "ray_local"])
def test_one_machine_may_share_a_file(launcher: str) -> None:
    assert SweepPlan.of(["seed=1", f"hydra/launcher={launcher}"], ()).settings
