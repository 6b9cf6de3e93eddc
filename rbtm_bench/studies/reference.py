"""The committed reference tables: results/reference/NAME.md and NAME.csv.

    python scripts/make_reference.py corridor      the demo's methods and seeds, simulated
    python scripts/make_reference.py kitti         20 frames of KITTI 00 (below RBTM_BENCH_DATA)
    python scripts/make_reference.py paper         of results/paper, left by reproduce_paper.py

They hold no times, dates or paths, so that the same versions on the same processor give the same
bytes. What they were made with stands in the Markdown. Runs go to results/reference_runs; a call
that was cut goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.files import make_folder, write_text
from rbtm_bench.core.geometry import inverse, rotation_angle, translation_norm
from rbtm_bench.core.guarded import guarded
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.kitti import Kitti
from rbtm_bench.engine import drive, sweep_folder
from rbtm_bench.report.frame import source_words
from rbtm_bench.runs import provenance
from rbtm_bench.runs.grid import Point, make_points
from rbtm_bench.runs.stored import Run, find_runs
from rbtm_bench.studies.campaign import STAMP, Campaign, begin
from rbtm_bench.studies.demo import BACKENDS, GRIDS, SEEDS
from rbtm_bench.studies.paper.plan import make_size
from rbtm_bench.studies.paper.tables import markdown, number
from rbtm_bench.studies.paper.words import short_table

OUT = Path("results/reference")
RUNS = Path("results/reference_runs")
PAPER = Path("results/paper")
COMMAND = "python scripts/make_reference.py"
DIGITS = 6
"""Of a number in a CSV file."""
NO_SETTINGS = "-"

ERRORS = {
    "final_translation_error_mm": "final_error_mm",
    "final_along_mm": "along_mm",
    "final_cross_mm": "cross_mm",
    "final_heading_error_deg": "heading_deg",
    "mean_gap": "mean_gap",
    "registrations": "registrations",
}

CLOUD_BACKENDS = (
    "open3d_p2p,open3d_p2plane,open3d_gicp,open3d_symmetric,open3d_ndt,kiss_icp,small_gicp_icp,"
    "small_gicp_plane,small_gicp_gicp,small_gicp_vgicp"
)
CLOUD_GRIDS = (
    ("backend=none", "selector=previous"),
    (f"backend={CLOUD_BACKENDS}", "selector=previous"),
    (f"backend={CLOUD_BACKENDS}", "selector=keyframe", "selector.distance=2.0"),
    (f"backend={CLOUD_BACKENDS}", "selector=fixed_gap", "selector.gap=3"),
    (f"backend={CLOUD_BACKENDS}", "selector=rbtm"),
)
"""20 frames are too few to choose settings on: RBTM's are the defaults, a keyframe every 2 m and a
gap of 3 frames are about as far."""
FRAMES = 20
TRUSTED = (14, 19)
"""First and last frame between which KITTI's poses agree with every registration: before, they look
extrapolated (a constant step of 0.86 m while all methods see it grow from 0.7 to 0.9 m)."""


def made_with() -> str:
    """What the last bits depend on, in a line."""
    names = {
        **sweep_folder.versions(),
        "numba": version("numba"),
        "small-gicp": version("small-gicp"),
    }
    listed = ", ".join(f"{name} {number}" for name, number in names.items())
    return f"{listed}; {provenance.processor()}"


def corridor_points(backends: str = BACKENDS) -> list[Point]:
    """The demo's methods on the demo's seeds, without pictures."""
    words = ["dataset=corridor", f"seed={SEEDS}", "overwrite=true", "pictures=false"]
    points = []
    for grid in GRIDS:
        chosen = [word.replace(f"backend={BACKENDS}", f"backend={backends}") for word in grid]
        points += make_points([*chosen, *words])[0]
    return points


def corridor_rows(runs: Sequence[Run]) -> pd.DataFrame:
    """A row a run: what it was, and ``ERRORS``."""
    rows = [
        {
            **_method(run),
            "seed": run.record["seed"],
            **{name: run.metrics.get(key) for key, name in ERRORS.items()},
        }
        for run in runs
    ]
    return pd.DataFrame(rows).sort_values(["backend", "selector", "seed"], ignore_index=True)


def corridor_page(table: pd.DataFrame) -> str:
    """Medians over seeds, a row a method."""
    rows = []
    for (backend, selector, settings), group in table.groupby(
        ["backend", "selector", "settings"], sort=False
    ):
        error = group["final_error_mm"]
        rows.append(
            {
                "backend": backend, "selector": selector, "settings": settings,
                "seeds": str(len(group)), "median (mm)": number(error.median()),
                "smallest": number(error.min()), "largest": number(error.max()),
                "along (mm)": number(group["along_mm"].median()),
                "cross (mm)": number(group["cross_mm"].median()),
                "heading (deg)": number(group["heading_deg"].median()),
                "mean gap": number(group["mean_gap"].median()),
            }
        )  # fmt: skip
    text = (
        f"Final position error on the simulated corridor (1.8 m, 181 scans, 10 mm noise) over "
        f"seeds {SEEDS}; along, cross and heading are signed medians. Settings were chosen on "
        "other seeds, four tries for each strategy (scripts/choose_demo_settings.py)."
    )
    return _page("Corridor", text, f"{COMMAND} corridor", [markdown(pd.DataFrame(rows))])


def cloud_points(folder: Path) -> list[Point]:
    """Every 3D backend with every strategy on the frames; the truth of the trusted ones."""
    words = [
        "dataset=kitti",
        f"dataset.path='{folder}'",
        f"dataset.max_scans={FRAMES}",
        f"dataset.ground_truth_frames=[{TRUSTED[0]},{TRUSTED[1]}]",
        "overwrite=true",
        "pictures=false",
    ]
    return [point for grid in CLOUD_GRIDS for point in make_points([*grid, *words])[0]]


def cloud_rows(runs: Sequence[Run], truth: Mapping[int, Array]) -> pd.DataFrame:
    """A row a run; ``truth`` holds the official poses by frame.

    Against the poses: the motion from the first to the last trusted frame, and the mean over their
    single steps. Before them: the distance of the first trusted frame from the start, and how far
    that frame lies from where the methods put it (median pose of all that register, coordinate by
    coordinate).
    """
    first, last = TRUSTED
    paths = {run: Trajectory.read_tum(run.path / "trajectory.tum").T_world_scan for run in runs}
    middle = np.median(
        [T[first, :3, 3] for run, T in paths.items() if run.record["choices"]["backend"] != "none"],
        axis=0,
    )
    rows = []
    for run, T in paths.items():
        if len(T) != FRAMES:
            raise DataError(f"{run.path}: {len(T)} frames, expected {FRAMES}")
        whole = _error(T, truth, first, last)
        steps = [_error(T, truth, k, k + 1) for k in range(first, last)]
        rows.append(
            {
                **_method(run),
                "error_m": whole[0],
                "error_deg": whole[1],
                "step_error_m": float(np.mean([step[0] for step in steps])),
                "step_error_deg": float(np.mean([step[1] for step in steps])),
                "distance_before_m": float(translation_norm(inverse(T[0]) @ T[first])),
                "from_median_before_m": float(np.linalg.norm(T[first, :3, 3] - middle)),
                "mean_gap": run.metrics.get("mean_gap"),
                "fallbacks": run.metrics.get("fallbacks"),
            }
        )
    return pd.DataFrame(rows).sort_values(["backend", "selector"], ignore_index=True)


def _error(T: Array, truth: Mapping[int, Array], start: int, end: int) -> tuple[float, float]:
    """Of the motion between two frames: translation in m and rotation in deg."""
    off = inverse(inverse(truth[start]) @ truth[end]) @ inverse(T[start]) @ T[end]
    return float(translation_norm(off)), float(np.degrees(rotation_angle(off)))


def cloud_page(table: pd.DataFrame) -> str:
    first, last = TRUSTED
    heads = {
        "backend": "backend", "selector": "selector", "settings": "settings",
        "error_m": f"{first} to {last}: error (m)", "error_deg": "(deg)",
        "step_error_m": "mean of its steps (m)", "step_error_deg": "(deg) ",
        "distance_before_m": f"0 to {first}: distance (m)",
        "from_median_before_m": "from the median (m)", "mean_gap": "mean gap",
        "fallbacks": "fallbacks",
    }  # fmt: skip
    shown = table[list(heads)].copy()
    for name in shown.columns[3:]:
        shown[name] = [number(value) for value in shown[name]]
    shown["distance_before_m"] = [f"{value:.2f}" for value in table["distance_before_m"]]
    gap = table.loc[table["selector"] == "rbtm", "mean_gap"].median()
    text = (
        f"Frames 0 to {FRAMES - 1} of KITTI odometry sequence 00 (Geiger et al. 2012); guess: the "
        "last motion, voxels of 0.5 m, correspondence distance 1 m. The official poses are trusted "
        f"from frame {first} on only. The error is that of the motion from frame {first} to "
        f"{last} (about 4.4 m), beside it the mean over its single steps. For the frames before, "
        f"methods are compared with each other: how far from the start they put frame {first}, and "
        "how far that is from the median of all that register: agreement, not truth. No setting "
        "was chosen on these frames, they are too few. It is one short drive: differences of a "
        f"centimetre mean nothing. The mean gap of RBTM with its defaults is {number(gap)} frames: "
        "mostly it takes the previous frame, by choice or as its fallback."
    )
    return _page("KITTI frames", text, f"{COMMAND} kitti", [markdown(shown.rename(columns=heads))])


def _method(run: Run) -> dict[str, Any]:
    return {
        "backend": run.record["choices"]["backend"],
        "selector": run.record["choices"]["selector"],
        "settings": " ".join([*_settings(_acting(run)), *_source(run)]) or NO_SETTINGS,
    }


def _acting(run: Run) -> dict[str, Any]:
    """The selector's settings but those that do nothing beside the others."""
    idle = run.record.get("idle") or ()
    return {k: v for k, v in run.section("selector").items() if f"selector.{k}" not in idle}


def _source(run: Run) -> list[str]:
    return [f"gaps of {source_words(run)}"] if run.config["selector"].get("gaps_from") else []


def _settings(selector: dict[str, Any]) -> list[str]:
    """All of a selector's settings, as overrides."""
    own = [f"{k}={selector[k]:g}" for k in ("window", "threshold") if selector.get(k) is not None]
    return [*own, _own_settings(selector)] if _own_settings(selector) else own


def _own_settings(selector: dict[str, Any]) -> str:
    """The selector's settings that have no column of their own, as overrides."""
    own = ("_target_", "window", "threshold", "seed", "gaps", "gaps_from")
    keyframes_unused = selector.get("content") == "scans"
    parts = []
    for key, value in selector.items():
        if key in own or value is None or (keyframes_unused and key.startswith("keyframe_")):
            continue
        if (key, value) in (("content", "scans"), ("fallback", "previous")):
            continue
        parts.append(f"{key}={f'{value:g}' if isinstance(value, float) else value}")
    return " ".join(parts)


def paper_files(out: Path, source: Path = PAPER) -> list[Path]:
    """Table I of a full run: short in Markdown, every number but times in CSV."""
    size = make_size(False, None, None, None)
    try:
        table = pd.read_csv(source / "table1.csv")
        stamp = json.loads((source / "runs" / STAMP).read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"{error.filename}: run scripts/reproduce_paper.py first") from error
    shown = table.loc[table["noise_mm"] > 0, "shown_on"].unique()
    if list(shown) != [f"seed=0-{size.seeds - 1}"] or set(table["backend"]) != set(size.backends):
        raise DataError(f"{source / 'table1.csv'}: not of a full run of reproduce_paper.py")
    versions = ", ".join(f"{name} {number}" for name, number in stamp["versions"].items())
    return _write(
        out,
        "paper_table1",
        table.drop(columns="ms_per_scan"),
        lambda rounded: paper_page(rounded, versions),
    )


def paper_page(table: pd.DataFrame, versions: str) -> str:
    """Table I of the paper's ICP, and the medians of all backends."""
    command = f"python scripts/reproduce_paper.py, then {COMMAND} paper"
    parts = short_table(table, make_size(False, None, None, None))
    return _page("The paper's Table I", "", command, parts, versions)


def _page(
    title: str, text: str, command: str, tables: Sequence[str], versions: str | None = None
) -> str:
    head = f"Made by `{command}` with {versions or made_with()}."
    return "\n\n".join(part for part in (f"# {title}", text, *tables, head) if part) + "\n"


def csv_text(table: pd.DataFrame) -> str:
    return table.to_csv(index=False, float_format=f"%.{DIGITS}g")


def _write(
    out: Path, name: str, table: pd.DataFrame, page: Callable[[pd.DataFrame], str]
) -> list[Path]:
    """The CSV file, and the page of what stands in it."""
    make_folder(out)
    files = [out / f"{name}.md", out / f"{name}.csv"]
    write_text(files[1], csv_text(table))
    write_text(files[0], page(pd.read_csv(files[1])))
    return files


def make(
    name: str,
    points: Sequence[Point],
    rows: Callable[[Sequence[Run]], pd.DataFrame],
    folder: Path,
    jobs: int,
) -> pd.DataFrame:
    """Make the runs and read them. Raises ``DataError`` if one failed: no table has holes."""
    begin(folder, fresh=False)
    with drive.make_crew(jobs) as crew:
        maker = Campaign(folder, crew)
        maker.make(name, points)
    shutil.rmtree(folder / "pairs", ignore_errors=True)
    for run, reason in maker.failed.items():
        raise DataError(f"{run}: {reason}")
    return rows(find_runs([folder / point.name for point in points]))


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=("corridor", "kitti", "paper"))
    parser.add_argument("data", type=Path, nargs="?", help="kitti: folder of sequences/ and poses/")
    parser.add_argument("--out", type=Path, default=OUT, help=f"folder (default {OUT})")
    parser.add_argument("--runs", type=Path, default=RUNS, help=f"of the runs (default {RUNS})")
    parser.add_argument("--jobs", "-j", type=int, default=drive.default_jobs())
    parser.add_argument("--debug", action="store_true", help="errors with their whole traceback")
    options = parser.parse_args(words)

    def call() -> int:
        folder = options.runs / options.part
        if options.part == "paper":
            written = paper_files(options.out)
        elif options.part == "corridor":
            table = make("corridor", corridor_points(), corridor_rows, folder, options.jobs)
            written = _write(options.out, "corridor", table, corridor_page)
        else:
            data = _kitti(options.data)
            rows = partial(cloud_rows, truth=Kitti(str(data)).ground_truth)
            table = make("kitti", cloud_points(data), rows, folder, options.jobs)
            written = _write(options.out, "kitti", table, cloud_page)
        for file in written:
            print(file)
        return 0

    return guarded(call, options.debug)


def _kitti(folder: Path | None) -> Path:
    if folder is None and "RBTM_BENCH_DATA" not in os.environ:
        raise ConfigError("kitti: expected its folder, or RBTM_BENCH_DATA to hold it")
    return folder or Path(os.environ["RBTM_BENCH_DATA"]) / "kitti"
