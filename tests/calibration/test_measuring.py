"""Registrations in child processes: failures are rows, a death costs one pair."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from rbtm_bench.calibration import measuring
from rbtm_bench.calibration.plan import CalibrationPlan
from rbtm_bench.calibration.sampling import draw
from rbtm_bench.calibration.track import track_of
from rbtm_bench.core.geometry import inverse, se2, se3
from rbtm_bench.engine import drive
from rbtm_bench.runs import settings
from rbtm_bench.runs.assembly import build

PLUGIN = '''
import os
from rbtm_bench.backends.base import Alignment, Backend
from rbtm_bench.core.errors import BackendError

class Moody(Backend):
    """Says no to scan 7 as the source, and ends its process at scan 20."""
    def build(self, points, planar):
        return None
    def align(self, source, target, T_target_source):
        if source.key[0][0] == 20:
            os._exit(3)
        if source.key[0][0] == 7:
            raise BackendError("not   this\\none")
        return Alignment(T_target_source)
'''


@pytest.fixture
def moody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    (tmp_path / "moody_for_pairs.py").write_text(PLUGIN)
    monkeypatch.syspath_prepend(str(tmp_path))
    return {"_target_": "moody_for_pairs.Moody"}


def test_failed_and_deadly_pairs_are_rows(moody: dict[str, Any]) -> None:
    composed = settings.compose_settings(["dataset.scans=30"])
    data = measuring.data_node(composed.config)
    sample = draw(track_of(measuring.opened(data)), CalibrationPlan(gaps=(1, 2), pairs=60))
    done: list[int] = []
    with drive.make_crew(1) as crew:
        rows = measuring.register(crew, data, moody, sample, True, done.append)
    assert isinstance(rows, pd.DataFrame) and len(rows) == len(sample.rows) == sum(done)
    source = sample.rows["source"].to_numpy()
    assert set(rows["reason"][source == 7]) == {"not this one"}
    assert set(rows["reason"][source == 20]) == {"the process died: exit code 3"}
    bad = (source == 7) | (source == 20)
    assert bad.any() and rows["error_m"].isna().to_numpy().tolist() == bad.tolist()
    E = np.linalg.inv(sample.truth) @ sample.guess  # it hands its guess back
    np.testing.assert_allclose(
        rows["error_m"][~bad], np.linalg.norm(E[~bad, :3, 3], axis=1), atol=1e-9
    )


def test_signed_errors_are_in_the_model_s_frame() -> None:
    """A model that looks along y of the world: what is ahead of it is along."""
    truth = se2(1.0, 0.2, 0.5)
    off = se2(1.0 + 0.03, 0.2 - 0.01, 0.5 + math.radians(2.0))
    along, cross, up, roll, pitch, heading = measuring.signed_errors(off, truth)
    np.testing.assert_allclose([along, cross, heading], [0.03, -0.01, 2.0], atol=1e-12)
    assert up == roll == pitch == 0.0
    world = se2(5.0, -3.0, math.pi / 2)  # moves both, and the frame with them
    E = inverse(world @ truth) @ (world @ off)
    assert np.linalg.norm(E[:3, 3]) == pytest.approx(math.hypot(along, cross))
    tilted = se3([0, 0, 0.1], Rotation.from_rotvec([0, 0.2, 0]).as_matrix())
    np.testing.assert_allclose(
        measuring.signed_errors(np.stack([tilted, np.eye(4)]), np.eye(4)[None].repeat(2, 0)),
        [[0, 0, 0.1, 0, math.degrees(0.2), 0], np.zeros(6)], atol=1e-12,
    )  # fmt: skip


def test_a_failed_pair_has_the_guess_s_error(moody: dict[str, Any]) -> None:
    data = measuring.data_node(settings.compose_settings(["dataset.scans=30"]).config)
    sample = draw(track_of(measuring.opened(data)), CalibrationPlan(gaps=(1,), pairs=60))
    with drive.make_crew(1) as crew:
        rows = measuring.register(crew, data, moody, sample, True, lambda n: None)
    expected = measuring.signed_errors(sample.guess, sample.truth)
    np.testing.assert_allclose(rows[list(measuring.SIGNED)].to_numpy(), expected, atol=1e-12)


def test_scores_are_those_of_single_calls() -> None:
    composed = settings.compose_settings(["dataset.scans=25", "similarity=overlap"])
    data, node = measuring.data_node(composed.config), composed.config["similarity"]
    dataset, similarity = measuring.opened(data), build(node)
    sample = draw(track_of(dataset), CalibrationPlan(gaps=(1, 3, 6), pairs=20))
    target, source = (sample.rows[c].to_numpy() for c in ("target", "source"))
    with drive.make_crew(1) as crew:
        scores = measuring.score(
            crew, data, node, target, source, sample.guess, True, lambda n: None
        )
        describe, score = crew[0].call(measuring.cost_of, data, node)
    described = [similarity.describe(scan) for scan in dataset]
    single = [
        similarity.scores_under(described[t][None], described[s], T[None])[0]
        for t, s, T in zip(target, source, sample.guess, strict=True)
    ]
    np.testing.assert_array_equal(scores, single)
    assert len(set(scores)) > 3 and 0 < describe < 1 and 0 < score < 1


def test_the_same_bits_with_one_process_and_with_two() -> None:
    composed = settings.compose_settings(["dataset.scans=60", "backend=open3d_p2plane"])
    data, node = measuring.data_node(composed.config), composed.config["backend"]
    sample = draw(
        track_of(measuring.opened(data)),
        CalibrationPlan(gaps=(1, 6), pairs=40, disturb=(0.05, 2.0)),
    )
    several = []
    for jobs in (1, 2):
        with drive.make_crew(jobs) as crew:
            rows = measuring.register(crew, data, node, sample, True, lambda n: None)
        several.append(rows.drop(columns="seconds"))
    pd.testing.assert_frame_equal(*several, check_exact=True)
    assert several[0]["error_m"].nunique() > 60
