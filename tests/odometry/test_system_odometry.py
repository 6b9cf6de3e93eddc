"""The loop for systems: edges, rows, bad scans; and systems in runs, grids, figures and lists."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from rbtm_bench.backends.system import System, Tracker
from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import BackendError, ConfigError
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Array, Scan, Step, StepTable
from rbtm_bench.metrics.summary import summarise_steps
from rbtm_bench.odometry.system import system_odometry
from rbtm_bench.runs import assembly
from rbtm_bench.runs.grid import make_points
from rbtm_bench.runs.settings import compose_settings
from rbtm_bench.runs.workbench import Workbench

ORIGIN = se2(3.0, -2.0, 0.7)
"""Where the scripted system puts its first scan: not at the identity."""


@dataclass
class Scripted(System):
    """Moves 1 m and turns 0.1 rad a scan, but for the scans that are ``bad`` or ``lost``."""

    bad: tuple[int, ...] = ()
    lost: tuple[int, ...] = ()
    started: list[Tracker] = field(default_factory=list)

    def start(self) -> Tracker:
        self.started.append(_Script(self))
        return self.started[-1]


class _Script(Tracker):
    def __init__(self, system: Scripted) -> None:
        self.system, self.scan = system, -1

    def place(self, points: Array, planar: bool) -> tuple[Array, bool | None]:
        self.scan = int(points[0, 2])
        if self.scan in self.system.bad:
            raise BackendError("too dark")
        return ORIGIN @ pose(self.scan), self.scan not in self.system.lost


def pose(number: int) -> Array:
    T = np.eye(4)
    for _ in range(number):
        T = T @ se2(1.0, 0.0, 0.1)
    return T


def stream(count: int = 6) -> list[Scan]:
    return [Scan(i, 0.1 * i, np.full((8, 3), float(i))) for i in range(count)]


def run(system: System) -> list[Step]:
    return list(system_odometry(stream(), system))


def statuses(steps: list[Step]) -> list[str]:
    return [step.record.status for step in steps]


# --- the loop -------------------------------------------------------------------------------


def test_the_first_scan_is_the_origin_and_edges_are_steps() -> None:
    steps = run(Scripted())
    assert statuses(steps) == ["first", *["registered"] * 5]
    assert steps[0].edges == ()
    for number, step in enumerate(steps):
        np.testing.assert_allclose(step.T_world_scan, pose(number), atol=1e-12)
        assert all((e.model, e.scan, e.kind) == (number - 1, number, "system") for e in step.edges)
    np.testing.assert_allclose(steps[3].edges[0].T_model_scan, se2(1.0, 0.0, 0.1), atol=1e-12)


def test_rows_claim_no_model_scan_and_no_fitness() -> None:
    steps = run(Scripted())
    for step in steps[1:]:
        row = step.record
        assert (row.model, row.gap, row.score, row.fitness, row.reused) == (None,) * 5
        assert row.registrations == 1 and row.t_register_s > 0.0
    values = summarise_steps(StepTable(step.record for step in steps))
    assert values["coverage"] == 1.0 and values["registrations"] == 5
    assert values["mean_gap"] is None and values["mean_fitness"] is None
    assert values["reused"] is None and values["degenerate"] is None


def test_an_unusable_scan_gets_the_last_motion_again() -> None:
    steps = run(Scripted(bad=(2, 3)))
    assert statuses(steps)[2:] == ["unusable", "unusable", "registered", "registered"]
    assert steps[2].record.reason == "scan 2: too dark"
    assert [step.edges[0].kind for step in steps[1:4]] == ["system", "predicted", "predicted"]
    for number, step in enumerate(steps):  # the motion is constant, so all predictions are right
        np.testing.assert_allclose(step.T_world_scan, pose(number), atol=1e-12)
    assert summarise_steps(StepTable(step.record for step in steps))["coverage"] == 3 / 5


def test_a_prediction_does_not_count_as_registered() -> None:
    steps = run(Scripted(lost=(3,)))
    assert statuses(steps)[3] == "predicted" and steps[3].record.converged is False
    assert steps[3].edges[0].kind == "predicted"
    assert summarise_steps(StepTable(step.record for step in steps))["coverage"] == 4 / 5


def test_the_system_may_begin_late() -> None:
    steps = run(Scripted(bad=(0, 1)))
    assert statuses(steps) == ["unusable", "unusable", "predicted", *["registered"] * 3]
    assert steps[2].record.reason == "no scan before it"
    np.testing.assert_allclose(steps[2].T_world_scan, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(steps[5].T_world_scan, pose(3), atol=1e-12)


def test_no_scan_at_all_and_a_fresh_tracker_for_each_run() -> None:
    system = Scripted()
    assert list(system_odometry([], system)) == []
    run(system)
    run(system)
    assert len({id(tracker) for tracker in system.started}) == 3


# --- checked before the plug-in sees it -----------------------------------------------------


@pytest.mark.parametrize(
    ("points", "named"),
    [
        (np.zeros((3, 3)), "scan 4: 3 points: expected at least 6"),
        (np.zeros((8, 2)), r"points \(8, 2\): expected \(N, 3\)"),
        (np.full((8, 3), np.nan), "some points are not finite"),
    ],
)
def test_bad_points(points: Array, named: str) -> None:
    with pytest.raises(BackendError, match=named):
        Scripted().start().track(Scan(4, 0.4, points))


def test_a_pose_that_is_no_motion_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Script, "place", lambda *_: (np.diag([2.0, 1.0, 1.0, 1.0]), None))
    assert statuses(run(Scripted())) == ["unusable"] * 6


def test_planar_scans_stay_in_the_plane(monkeypatch: pytest.MonkeyPatch) -> None:
    tilted = np.eye(4)
    tilted[[1, 2], [2, 1]], tilted[1, 1], tilted[2, 2] = (-0.1, 0.1), 0.99**0.5, 0.99**0.5
    monkeypatch.setattr(_Script, "place", lambda *_: (tilted, None))
    scan = Scan(0, 0.0, np.zeros((8, 3)), planar=True)
    T = Scripted().start().track(scan).T_world_scan
    assert T[2].tolist() == T[:, 2].tolist() == [0.0, 0.0, 1.0, 0.0]


# --- settings and grids ---------------------------------------------------------------------


def test_settings_hold_nothing_that_does_nothing() -> None:
    settings = compose_settings(["backend=kiss_icp_system", "selector=rbtm"])
    gone = {
        "selector",
        "similarity",
        "guess",
        "search",
        "check",
        "recovery",
        "target",
        "registration",
        "descriptor",
    }
    assert not gone & settings.config.keys() and "metrics" in settings.config
    assert settings.choices["selector"] == "none" and settings.choices["dataset"] == "corridor"


def test_settings_that_do_nothing_are_still_checked() -> None:
    with pytest.raises(ConfigError, match=r"selector\.window=1: "):
        compose_settings(["backend=kiss_icp_system", "selector=rbtm", "selector.window=1"])


def points(*words: str) -> tuple[list[str], list[str]]:
    found, notes = make_points(list(words))
    return [point.name for point in found], notes


def test_points_of_a_system_that_differ_in_selection_alone_are_one() -> None:
    names, notes = points(
        "backend=kiss_icp_system,none",
        "selector=previous,rbtm",
        "selector.threshold=0.6,0.7",
        "guess=identity,odometry",
    )
    assert names[0] == "kiss_icp_system" and len(names) == 1 + (1 + 2) * 2
    assert "merged: backend=kiss_icp_system needs no selector: its 2 points are one" in notes
    assert "merged: backend=kiss_icp_system needs no guess: its 2 points are one" in notes
    named = "merged: backend=kiss_icp_system has no selector.threshold: its 2 points are one"
    assert named in notes and len(notes) == len(set(notes)) == 4


def test_what_a_system_has_still_multiplies() -> None:
    names, notes = points(
        "backend=kiss_icp_system", "selector=previous,rbtm", "backend.max_range=3.0,4.0", "seed=0,1"
    )
    stem = "kiss_icp_system-max_range="
    assert names == [
        f"{stem}{tail}" for tail in ("3.0-seed=0", "3.0-seed=1", "4.0-seed=0", "4.0-seed=1")
    ]
    assert len(notes) == 1


def test_settings_that_feed_others_tell_no_systems_apart() -> None:
    names, notes = points("backend=kiss_icp_system", "registration.voxel_size=0.0,0.1")
    assert len(names) == 1 and notes[0].startswith("merged: kiss_icp_system voxel_size=0.1 is the")


def test_a_key_that_only_a_selector_has_is_a_mistake_for_systems_alone() -> None:
    with pytest.raises(ConfigError, match=r"selector\.window: no chosen member has such a setting"):
        make_points(["backend=kiss_icp_system", "selector.window=4"])


# --- runs -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The system beside point-to-point with two selectors."""
    out = tmp_path_factory.mktemp("systems") / "out"
    grid = ["backend=kiss_icp_system,open3d_p2p", "selector=previous,rbtm", "dataset.scans=30"]
    grid += ["controls=none"]
    assert main(["compare", *grid, f"out='{out}'", "--jobs", "1"]) == 0
    return out


def test_a_comparison_has_one_row_of_it(compared: Path) -> None:
    table = pd.read_csv(compared / "table.csv", keep_default_na=False).set_index("run")
    assert list(table.index) == ["kiss_icp_system", "open3d_p2p-previous", "open3d_p2p-rbtm"]
    row = table.loc["kiss_icp_system"]
    assert (row["status"], row["selector"], row["window"]) == ("done", "none", "")
    assert float(row["coverage"]) == 1.0 and float(row["final_translation_error_mm"]) < 30.0


def test_its_folder_holds_what_others_hold(compared: Path) -> None:
    folder = compared / "kiss_icp_system"
    files = {path.name for path in folder.iterdir()}
    assert files == {path.name for path in (compared / "open3d_p2p-previous").iterdir()}
    steps = pq.read_table(folder / "steps.parquet").to_pydict()
    assert steps["status"] == ["first", *["registered"] * 29]
    assert set(steps["model"]) == set(steps["gap"]) == {None}
    assert json.loads((folder / "metrics.json").read_text())["mean_gap"] is None


def test_figures_leave_out_the_selection_that_it_has_not(compared: Path, tmp_path: Path) -> None:
    assert main(["plot", str(compared), "--out", str(tmp_path)]) == 0
    names = {path.name for path in tmp_path.glob("*.png")}
    assert {"kiss_icp_system-map.png", "open3d_p2p-rbtm-gap.png", "errors.png"} <= names
    assert "kiss_icp_system-gap.png" not in names


def test_the_workbench_gives_it_shared_scans_and_nothing_else() -> None:
    settings = compose_settings(["backend=kiss_icp_system", "dataset.scans=10"])
    plain, bench = assembly.instantiate(settings), Workbench()
    parts = [plain, bench.parts(settings), bench.parts(settings)]
    assert all(isinstance(part.method, System) for part in parts)
    poses = [
        [step.T_world_scan.tobytes() for step in system_odometry(p.dataset, p.method)]
        for p in parts
    ]
    assert poses[0] == poses[1] == poses[2]


def test_it_runs_where_a_selector_could_not(tmp_path: Path) -> None:
    """3D clouds with the default similarity of 2D: of no concern to a system."""
    from cloud_helpers import write_hall

    write_hall(tmp_path / "hall", scans=4)
    words = ["dataset=cloud_folder", f"dataset.path='{tmp_path / 'hall'}'", "pin=false"]
    words += ["backend=kiss_icp_system", "similarity=curvature_circular", "guess=odometry"]
    assert main(["run", *words, f"out='{tmp_path / 'out'}'"]) == 0
    assert json.loads((tmp_path / "out" / "run.json").read_text())["status"] == "done"


def test_it_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "backend"]) == 0
    (line,) = [row for row in capsys.readouterr().out.splitlines() if " kiss_icp_system " in row]
    assert "system" in line and "missing" not in line


def test_it_is_pinned_to_the_data_it_can_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from rbtm_bench.backends.kiss_icp_system import KissICPSystem

    monkeypatch.setattr(KissICPSystem, "dimensions", ("3d",))
    assert main(["run", "backend=kiss_icp_system", "pin=false", f"out='{tmp_path / 'o'}'"]) == 2
    assert "backend=kiss_icp_system is for 3d only; this data set is 2d" in capsys.readouterr().err
