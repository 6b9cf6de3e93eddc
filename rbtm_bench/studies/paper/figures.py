"""The figures of scripts/reproduce_paper.py: what each of them shows, drawn by plots.paper."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import beam_points
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.datasets.environments import PAPER
from rbtm_bench.plots import maps, paper, style
from rbtm_bench.plots import ratios as ratio_plots
from rbtm_bench.plots.folder import read_scene, read_similarity, read_steps
from rbtm_bench.runs.stored import Run
from rbtm_bench.selection.rbtm import Rbtm
from rbtm_bench.similarity.curvature import Curvature
from rbtm_bench.similarity.curvature_circular import CurvatureCircular
from rbtm_bench.studies.paper.plan import PAPER_BACKEND, TableOne
from rbtm_bench.studies.paper.tables import ERROR, PARTS, number, read, replicate
from rbtm_bench.studies.paper.ways import NOISE_MM

THEIR_RATIO = 1076.3 / 7.423
APART_CM = 10.0
"""Between the two scans of Fig. 1(b)."""
EXAMPLE_SCANS, EXAMPLE_WINDOW, EXAMPLE_THRESHOLD = 19, 4, 0.45
"""Fig. 2(a): 10 cm between scans, and the paper's window."""
MAX_RANGE = 4.0
"""m, of the simulated sensor."""
HALF_SPAN_DEG = 5.0
"""Of the circular descriptor, as in configs/dataset/corridor.yaml."""


def draw(
    folder: Path,
    out: Path,
    table: TableOne,
    chosen: Mapping[str, int],
    shown: Mapping[str, list[str]],
    table1: pd.DataFrame,
    ratio: pd.DataFrame,
) -> list[Path]:
    """Draw all figures into ``out``, from the runs of ``folder`` named in ``shown``."""
    runs = {way: done[0] for way, names in shown.items() if (done := read(folder, names))}
    written: list[Path] = []
    with style.paper():
        for stem, figure in _figures(runs, table, chosen, table1, ratio):
            written += style.save(figure, out, stem)
    return written


def _figures(
    runs: Mapping[str, Run],
    table: TableOne,
    chosen: Mapping[str, int],
    table1: pd.DataFrame,
    ratio: pd.DataFrame,
) -> Iterator[tuple[str, Figure]]:
    yield "fig1b", descriptors(table.size.scans)
    yield "fig1c", matrices(runs)
    yield "fig2", model_choice(runs["circular"])
    yield "fig3", environment(table.size.scans)
    yield from (("fig4" + letter, figure) for letter, figure in _maps(runs, table, chosen, table1))
    yield "fig_ratio", ratios(ratio)


def descriptors(scans: int) -> Figure:
    """Two scans and their literal descriptors, without noise and with it."""
    apart = max(1, round(APART_CM * (scans - 1) / 180))
    similarity = Curvature()
    pairs = []
    for noise_mm in (0.0, NOISE_MM):
        data = Corridor(scans=scans, range_noise=noise_mm / 1000)
        phi = (similarity.describe(data[0]), similarity.describe(data[apart]))
        score = float(similarity.scores(phi[0][None], phi[1])[0])
        name = "without noise" if noise_mm == 0 else f"{noise_mm:g} mm of range noise"
        pairs.append(paper.DescriptorPair(name, phi, score))
    data = Corridor(scans=scans, range_noise=0.0)
    places = ("scan j = 1", f"scan k = {apart + 1}, {APART_CM:g} cm further")
    views = tuple(_view(data, k, name) for k, name in zip((0, apart), places, strict=True))
    return paper.descriptors(paper.outline(PAPER.walls), (views[0], views[1]), pairs)


def _view(data: Corridor, index: int, name: str) -> paper.View:
    scan = data[index]
    pose = data.ground_truth[index]
    ranges = np.where(np.isfinite(data.ranges[index]), data.ranges[index], MAX_RANGE)
    ends = beam_points(ranges, data.angles)
    return paper.View(name, pose, _moved(pose, scan.points), _moved(pose, ends))


def _moved(pose: Array, points: Array) -> Array:
    """Points (N, 3) of a scan in the world, from above (N, 2)."""
    return (points @ pose[:3, :3].T + pose[:3, 3])[:, :2]


def matrices(runs: Mapping[str, Run]) -> Figure:
    """The similarity of all pairs: the paper's descriptor without and with noise, and ours."""
    titled = []
    for way, title in (
        ("literal_clean", "(a) paper's descriptor, no noise"),
        ("literal", f"(b) the same, {NOISE_MM:g} mm noise"),
        ("circular", f"(c) circular, {NOISE_MM:g} mm noise"),
    ):
        similarity = read_similarity(runs[way]) if way in runs else None
        if similarity is not None:
            titled.append((title, similarity))
    return paper.matrices(titled)


def model_choice(run: Run) -> Figure:
    """Steps 2 to 5 of a coarse drive with the paper's window, and a whole run of Table I."""
    data = Corridor(scans=EXAMPLE_SCANS)
    similarity = CurvatureCircular(half_span_deg=HALF_SPAN_DEG)
    selector = Rbtm(window=EXAMPLE_WINDOW, threshold=EXAMPLE_THRESHOLD)
    known = [similarity.describe(scan) for scan in list(data)[:6]]
    example = []
    for scan in range(1, 5):
        models = np.arange(max(0, scan - EXAMPLE_WINDOW + 1), scan)
        scores = similarity.scores(np.stack([known[m] for m in models]), known[scan])
        model = selector.select(scan, models, scores).candidates[0].model
        example.append(
            (scan + 1, [_tried(int(m), s, model) for m, s in zip(models, scores, strict=True)])
        )
    title = (
        "oldest candidate first, on this corridor with a scan every 10 cm: "
        f"window {EXAMPLE_WINDOW}, threshold Th = {EXAMPLE_THRESHOLD:g}"
    )
    settings = run.config["selector"]
    whole = f"a run of Table I: window {settings['window']}, threshold {settings['threshold']:g}"
    steps = read_steps(run)
    assert steps is not None
    return paper.model_choice(example, title, steps, f"{whole}, {_seed(run)}")


def _tried(model: int, score: float, chosen: int) -> paper.Tried:
    """What became of a candidate; scans count from 1, as in the paper."""
    outcome = "chosen" if model == chosen else "below" if model < chosen else "not asked"
    return paper.Tried(int(model) + 1, float(score), outcome)


def environment(scans: int) -> Figure:
    """The corridor with the drive and the first scan."""
    data = Corridor(scans=scans)
    beams, field = len(data.angles), np.degrees(data.angles[-1] - data.angles[0])
    text = (
        f"The simulated corridor after Fig. 3 (cm). Sensor: {field:.0f} deg, {beams} beams, "
        f"range {MAX_RANGE:g} m, noise {NOISE_MM:g} mm"
    )
    path = data.ground_truth[:, :2, 3]
    return paper.environment(
        paper.outline(PAPER.walls), _view(data, 0, "start"), data.ground_truth[-1], path, text
    )


def _maps(
    runs: Mapping[str, Run], table: TableOne, chosen: Mapping[str, int], table1: pd.DataFrame
) -> Iterator[tuple[str, Figure]]:
    """Fig. 4(a) and (b) in the same limits."""
    scenes = {way: read_scene(runs[way]) for way in ("standard", "circular") if way in runs}
    known = {way: scene for way, scene in scenes.items() if scene is not None}
    limits = maps.view(list(known.values()))
    for letter, (way, scene) in zip("ab", known.items(), strict=False):
        run = runs[way]
        mm, along, cross, turn = (number(run.metrics[key]) for key in (ERROR, *PARTS.values()))
        yield (
            letter,
            paper.map_figure(
                scene,
                limits,
                f"({letter}) {table.ways[way].name}, {table.ways[way].brief(chosen[way])}, "
                f"{_seed(run)}\nfinal error {mm} mm ({_median(table1, way)})\n"
                f"along {along} mm, cross {cross} mm, heading {turn} deg",
            ),
        )


def _median(table1: pd.DataFrame, way: str) -> str:
    """Of all seeds, beside the one that a figure shows."""
    rows = table1[(table1["way"] == way) & (table1["backend"] == PAPER_BACKEND)]
    row = rows.iloc[0]
    return f"median of {row['runs']} seeds {number(row['median_error_mm'])} mm"


def _seed(run: Run) -> str:
    return f"seed {replicate(run)}"


def ratios(table: pd.DataFrame) -> Figure:
    """The ratio standard / RBTM, and standard / fixed gap in the same cells."""
    rows = [
        (name, _cells(table, f"standard_over_{way}"))
        for way, name in (("circular", "standard / RBTM"), ("fixed_gap", "standard / fixed gap"))
    ]
    runs = int(table["runs"].max())
    title = (
        "How many times smaller than the standard ICP's is the final error of RBTM (above) and of "
        f"a fixed gap (below)? Point-to-point ICP, median over {runs} seeds"
    )
    return ratio_plots.draw(rows, title, THEIR_RATIO)


def _cells(table: pd.DataFrame, column: str) -> Sequence[ratio_plots.Ratio]:
    return [
        ratio_plots.Ratio(int(n), float(noise), float(distance), float(value))
        for n, noise, distance, value in zip(
            table["scans"], table["noise_mm"], table["distance_m"], table[column], strict=True
        )
    ]
