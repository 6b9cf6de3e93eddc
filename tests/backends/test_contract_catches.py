"""The contract tests fail for plug-ins that are wrong, each in the test that is meant for it.

The wrong plug-ins enter as anybody's would: a package of their own and a folder of configs.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

P2P, DISTANCE = "rbtm_bench.backends.open3d_p2p.Open3DPointToPoint", "max_correspondence_distance"

WRONG = {
    # group, name: (the test that must fail, base class, body of the class)
    ("backend", "inverse"): (
        "test_the_result_maps_source_points_into_the_target_frame",
        P2P,
        """
        def align(self, source, target, guess):
            result = super().align(source, target, guess)
            return replace(result, T_target_source=inverse(result.T_target_source))
        """,
    ),
    ("backend", "deaf"): (
        "test_known_motions_are_found",
        P2P,
        "def align(self, source, target, guess): return super().align(source, target, np.eye(4))",
    ),
    ("backend", "silent"): (
        "test_what_the_base_class_guarantees_is_not_replaced",
        P2P,
        """
        def register(self, source, target, guess):
            result = super().register(source, target, guess)
            far = np.linalg.norm(guess[:3, 3] - result.T_target_source[:3, 3]) > 1.0
            return replace(result, T_target_source=guess.copy()) if far else result
        """,
    ),
    ("backend", "stateful"): (
        "test_the_order_of_registrations_does_not_matter",
        P2P,
        """
        last = np.eye(4)
        def align(self, source, target, guess):
            result = super().align(source, target, guess @ self.last)
            self.last = se2(0.001, 0, 0) @ self.last
            return result
        """,
    ),
    ("backend", "chancy"): (
        "test_repeated_registrations_give_the_same_bits",
        P2P,
        """
        def align(self, source, target, guess):
            result = super().align(source, target, guess)
            jump = se2(1e-6 * np.random.rand(), 0, 0)
            return replace(result, T_target_source=jump @ result.T_target_source)
        """,
    ),
    ("backend", "scribbler"): (
        "test_scans_and_prepared_scans_are_not_modified",
        P2P,
        """
        def align(self, source, target, guess):
            source.points[0, 0] += 1e-9
            return super().align(source, target, guess)
        """,
    ),
    ("backend", "own_fitness"): (
        "test_what_the_base_class_guarantees_is_not_replaced",
        P2P,
        """
        def register(self, source, target, guess):
            result = super().register(source, target, guess)
            return replace(result, library_fitness=1.0)
        """,
    ),
    ("backend", "tilted"): (
        "test_what_the_base_class_guarantees_is_not_replaced",
        P2P,
        """
        def register(self, source, target, guess):
            result = super().register(source, target, guess)
            result.T_target_source[2, 3] = 1e-12
            return result
        """,
    ),
    ("backend", "trusting"): (
        "test_what_the_base_class_guarantees_is_not_replaced",
        P2P,
        """
        def register(self, source, target, guess):
            return super().register(source, target, guess if is_rigid(guess) else np.eye(4))
        """,
    ),
    ("similarity", "all_knowing"): (
        "test_a_scan_without_returns_has_no_score",
        "rbtm_bench.similarity.curvature_circular.CurvatureCircular",
        "def pair_scores(self, a, b): return np.nan_to_num(super().pair_scores(a, b))",
    ),
    ("similarity", "lopsided"): (
        "test_scores_are_symmetric",
        "rbtm_bench.similarity.curvature_circular.CurvatureCircular",
        "def pairwise(self, a, b): return super().pairwise(a, b) * (1 - 1e-6 * np.abs(a[:, :1]))",
    ),
    ("similarity", "shifted"): (
        "test_all_roads_lead_to_the_same_scores",
        "rbtm_bench.similarity.curvature_circular.CurvatureCircular",
        "def band(self, d, window): return np.roll(super().band(d, window), 1, axis=0)",
    ),
    ("selector", "stranger"): (
        "test_every_scan_gets_a_candidate",
        "rbtm_bench.selection.previous.Previous",
        """
        def select(self, scan, models, scores):
            return Selection((Candidate(scan, 1.0, "itself"),))
        """,
    ),
    ("selector", "fussy"): (
        "test_every_scan_gets_a_candidate",
        "rbtm_bench.selection.rbtm.Rbtm",
        "def select(self, *given): return Selection(super().select(*given).candidates[:-1])",
    ),
    ("guess", "backwards"): (
        "test_noise_free_odometry_gives_the_true_motion",
        "rbtm_bench.guess.odometry.Odometry",
        "def predict(self, m, scan, recent): return inverse(super().predict(m, scan, recent))",
    ),
    ("guess", "not_so_pure"): (
        "test_a_pure_guess_does_not_look_at_the_trajectory",
        "rbtm_bench.guess.constant_velocity.ConstantVelocity",
        "pure = True",
    ),
    ("check", "mute"): (
        "test_a_refusal_has_a_reason",
        "rbtm_bench.check.none.AcceptAll",
        "def reject(self, result, T_guess): return '' if result.fitness < 0.5 else None",
    ),
    ("target", "elsewhere"): (
        "test_the_target_lies_in_the_model_scan_s_frame",
        "rbtm_bench.target.single.SingleScan",
        """
        def build(self, model, window, backend):
            return backend.merge([(window.node(model).prepared, window.node(model).T_world_scan)])
        """,
    ),
    ("dataset", "fickle"): (
        "test_indexing_twice_gives_the_same_bits",
        "rbtm_bench.datasets.corridor.Corridor",
        """
        def __getitem__(self, i):
            scan = super().__getitem__(i)
            return replace(scan, points=scan.points + [1e-6 * np.random.rand(), 0, 0])
        """,
    ),
}

HEAD = """
from dataclasses import replace
from importlib import import_module
import numpy as np
from rbtm_bench.core.geometry import inverse, is_rigid, se2
from rbtm_bench.selection.base import Candidate, Selection
"""


def write(folder: Path) -> None:
    """The package ``wrong_plugins`` and the configs of its members."""
    text = HEAD
    for (group, name), (_, base, body) in WRONG.items():
        module, _, parent = base.rpartition(".")
        lines = [line.removeprefix("        ") for line in body.strip("\n").splitlines()]
        body = "\n".join(f"    {line}" for line in lines)
        text += f"class {group}_{name}(import_module('{module}').{parent}):\n{body}\n"
        path = folder / "configs" / group / f"{name}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        node = f"_target_: wrong_plugins.{group}_{name}\n"
        if group == "backend":
            node += f"{DISTANCE}: ${{registration.{DISTANCE}}}\n"
        if group == "dataset":
            lines = ["# @package _global_", "dataset:", f"  {node.strip()}", "  scans: 3"]
            node = "\n".join(lines) + "\n"
        path.write_text(node)
    (folder / "wrong_plugins.py").write_text(text)


@pytest.fixture(scope="module")
def failures(tmp_path_factory: pytest.TempPathFactory) -> set[tuple[str, str]]:
    """(test, plug-in) of everything that failed, out of a run in a process of its own."""
    folder = tmp_path_factory.mktemp("wrong plug-ins")
    write(folder)
    tests = " or ".join(sorted({test for test, _, _ in WRONG.values()}))
    words = ["--config-dir", "configs", "-k", f"({tests}) and not 3d", "-q", "--tb=no", "-rfE"]
    for group, name in WRONG:
        words += ["--plugin", f"{group}={name}"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(folder)])}
    environment.pop("PYTEST_ADDOPTS", None)
    loads = [sys.executable, "-c", "import wrong_plugins"]
    subprocess.run(loads, cwd=folder, env=environment, check=True)
    done = subprocess.run(
        [sys.executable, "-m", "rbtm_bench.contract", *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    failed = re.findall(r"^(?:FAILED|ERROR) \S*::(\w+)\[(\w+)", done.stdout, re.MULTILINE)
    assert failed, done.stdout + done.stderr
    return set(failed)


@pytest.mark.slow
@pytest.mark.parametrize(("group", "name"), list(WRONG), ids=[f"{g}-{n}" for g, n in WRONG])
def test_a_wrong_plugin_is_caught(group: str, name: str, failures: set[tuple[str, str]]) -> None:
    expected = WRONG[group, name][0]
    tests = {test for test, plugin in failures if plugin == name}
    assert expected in tests, f"{group}={name} fails only {sorted(tests)}"
