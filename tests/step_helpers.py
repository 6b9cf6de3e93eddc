"""Whole runs of the loop, and whether two are the same to the bit."""

from __future__ import annotations

from typing import Any

import numpy as np

from rbtm_bench.core.types import Step
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.runs import assembly

TIMES = ("t_prepare_s", "t_describe_s", "t_guess_s", "t_select_s", "t_register_s", "t_check_s")


def steps(parts: assembly.Parts) -> list[Step]:
    """A whole run."""
    return list(odometry(parts.dataset, parts.method, parts.work))


def rows(run: list[Step]) -> list[dict[str, Any]]:
    """What must not differ: everything but times and whether it was reused."""
    exempt = (*TIMES, "search_seconds", "reused")
    return [{k: v for k, v in s.record.as_dict().items() if k not in exempt} for s in run]


def assert_same(one: list[Step], other: list[Step]) -> None:
    """The same bits in poses, edges and rows."""
    np.testing.assert_equal(rows(one), rows(other))
    for a, b in zip(one, other, strict=True):
        assert a.T_world_scan.tobytes() == b.T_world_scan.tobytes()
        assert [e.T_model_scan.tobytes() for e in a.edges] == [
            e.T_model_scan.tobytes() for e in b.edges
        ]
