"""RBTM with a check that it brings along."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from loop_helpers import NAN, Perfect, Script, drive, method, rows

from rbtm_bench.check.consistent import Consistent
from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.runs.assembly import instantiate
from rbtm_bench.runs.grid import make_points
from rbtm_bench.runs.settings import compose_settings
from rbtm_bench.selection.rbtm import Rbtm
from rbtm_bench.selection.rbtm_verified import RbtmVerified

FEW = ("dataset.scans=8", "backend=none")


def test_it_brings_its_check() -> None:
    settings = compose_settings(["selector=rbtm_verified", *FEW])
    assert (settings.choices["selector"], settings.choices["check"]) == (
        "rbtm_verified",
        "consistent",
    )
    parts = instantiate(settings)
    assert type(parts.method.selector) is RbtmVerified and type(parts.method.check) is Consistent


def test_its_check_has_settings() -> None:
    settings = compose_settings(["selector=rbtm_verified", "check.min_fitness=0.9", *FEW])
    assert settings.config["check"]["min_fitness"] == 0.9
    assert "check" not in settings.config["selector"]


def test_data_sets_still_set_their_defaults() -> None:
    words = ["selector=rbtm_verified", "dataset=carmen", "dataset.path=somewhere"]
    assert compose_settings(words).choices["guess"] == "odometry"
    assert compose_settings(words).choices["check"] == "consistent"
    assert compose_settings(["dataset=carmen", "dataset.path=x"]).choices["check"] == "none"


def test_in_a_comparison_each_has_its_own() -> None:
    points, _ = make_points(["selector=rbtm,rbtm_verified", *FEW])
    checks = {point.name: point.settings.choices["check"] for point in points}
    assert checks == {"none-rbtm": "none", "none-rbtm_verified": "consistent"}


def test_without_a_check_it_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["selector=rbtm_verified", "check=none", *FEW]
    with pytest.raises(ConfigError, match=r"selector=rbtm_verified .*check=none .*check=gated"):
        instantiate(compose_settings(words))
    assert main(["run", *words, f"out='{tmp_path / 'out'}'"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_the_order_is_rbtms() -> None:
    for seed in range(20):
        scores = np.random.default_rng(seed).uniform(0, 1, 9)
        numbers = np.arange(9)
        given = (9, numbers, scores)
        assert RbtmVerified(10).select(*given) == Rbtm(10).select(*given)


def test_the_fallback_is_checked_as_well() -> None:
    """Nothing is similar to scan 3, and the newest is lost: its pose is the predicted one."""
    table = {(0, 1): 0.9, (0, 2): 0.9}
    backend = Perfect(lost=[(2, 3)])
    checked = method(backend, RbtmVerified(9, threshold=0.5), Script(table, NAN))
    steps = list(odometry(drive(4), checked))
    assert rows(steps)[2:] == [("registered", 0), ("predicted", None)]
    assert backend.tried[-1] == (2, 3)
    assert (steps[3].record.rejected, steps[3].record.reason) == (1, "not converged")
