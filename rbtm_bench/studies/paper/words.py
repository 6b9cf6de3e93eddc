"""The words of scripts/reproduce_paper.py: its README, the page of Table I, and its last lines."""

from __future__ import annotations

import textwrap
from collections.abc import Hashable, Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from tabulate import tabulate

from rbtm_bench.studies.paper.findings import (
    SHOWN_MEANS,
    against_the_controls,
    in_short,
    literal_fires,
    other_backends,
    ratio_in_words,
    when_curved,
)
from rbtm_bench.studies.paper.plan import (
    CHOICE_BEAMS,
    FIRST_CHOICE,
    PAPER_BACKEND,
    SHOWN_BEAMS,
    PaperSize,
)
from rbtm_bench.studies.paper.tables import between, by_backend, markdown, number, paper_icp
from rbtm_bench.studies.paper.ways import NOISE_MM, PATH_CM, window_of

WIDEST_HEAD = 8
"""Letters of a line above a column of the terminal's table."""


def final_words(table: pd.DataFrame, size: PaperSize) -> str:
    """For the terminal, 100 columns: the other backends' medians, then Table I, a method a line."""
    others = by_backend(table[table["backend"] != PAPER_BACKEND])
    short = paper_icp(table)
    heads = [str(name).replace("heading", "head.").replace(" ", "\n") for name in short]
    align = ["left", "left", "right", "left"] + ["right"] * (len(short.columns) - 4)
    parts = [
        _terminal(short, heads, align),
        f"Table I: {_title(size)}.\nIts matcher is {PAPER_BACKEND}, the paper's. {_chosen(size)}.",
    ]
    if len(others):
        heads = [textwrap.fill(str(name), WIDEST_HEAD) for name in others]
        align = ["left"] + ["right"] * (len(others.columns) - 1)
        others = others.replace(r" \(([+-])\)", r"\1", regex=True)
        words = (
            "The same of the other backends (mm); + and -: RBTM, circular, is shown better, worse"
        )
        parts += [_terminal(others, heads, align), words]
    return "\n".join(reversed(parts))


def _terminal(table: pd.DataFrame, heads: list[str], align: list[str]) -> str:
    """As narrow as it can be: tabulate would widen every column by its head's padding."""
    lines = [head.split("\n") for head in heads]
    tall = max(map(len, lines))
    above = [[*([""] * (tall - len(words))), *words] for words in lines]
    cells = [list(row) for row in zip(*above, strict=True)] + table.to_numpy().tolist()
    rule = ["-" * max(map(len, column)) for column in zip(*cells, strict=True)]
    rows = [*cells[:tall], rule, *cells[tall:]]
    return tabulate(rows, tablefmt="plain", disable_numparse=True, colalign=align)


def _title(size: PaperSize) -> str:
    return (
        f"final position error (mm), median over {size.seeds} seeds; path {10 * PATH_CM:.0f} mm, "
        f"{size.scans} scans,\n{NOISE_MM:g} mm noise unless said"
    )


def _chosen(size: PaperSize) -> str:
    last = FIRST_CHOICE + size.choice_seeds - 1
    return f"Each setting is the best of four on seeds {FIRST_CHOICE} to {last}"


def table_page(table: pd.DataFrame, size: PaperSize) -> str:
    """``table1.md``: Table I in short, then every backend in full."""
    parts = ["# Table I", *short_table(table, size), _columns(size)]
    for backend, group in table.groupby("backend", sort=False):
        rows = [
            {
                "method": row["method"], "chosen setting": row["setting"], "tried": row["tried"],
                "runs": row["runs"], "median (mm)": number(row["median_error_mm"]),
                "95% interval": between(row["low_mm"], row["high_mm"]),
                "largest": number(row["largest_error_mm"]), "along (mm)": number(row["along_mm"]),
                "cross (mm)": number(row["cross_mm"]), "heading (deg)": number(row["heading_deg"]),
                "largest heading": number(row["largest_heading_deg"]),
                "standard / this": number(row["standard_over_this"]),
                "95% of it": between(row["standard_over_low"], row["standard_over_high"]),
                "fired": f"{row['fired'] / max(row['scans'], 1):.1%}",
                "mean gap": number(row["mean_gap"]),
                "below RBTM": "" if pd.isna(row["smaller_than_rbtm"])
                else f"{row['smaller_than_rbtm']:.0f} of {row['runs']}",
                "p (Holm)": "" if pd.isna(row["p_holm"]) else f"{row['p_holm']:.2g}",
            }
            for row in group.to_dict("records")
        ]  # fmt: skip
        parts += [f"## {backend}", markdown(pd.DataFrame(rows))]
    return "\n\n".join(parts) + "\n"


def short_table(table: pd.DataFrame, size: PaperSize) -> list[str]:
    """Table I of the paper's ICP, and the medians of all backends."""
    title = _title(size).replace("\n", " ")
    return [
        f"With the paper's matcher, point-to-point ICP ({PAPER_BACKEND}): {title}. "
        f"{_chosen(size)}. Along and cross say where the end lies from the true one (too far and "
        "to the left are positive), standard / this how many times smaller the error is than the "
        "standard way's on the same data (median over seeds of a seed's own ratio). Without noise "
        "other sensors take the place of seeds.",
        markdown(paper_icp(table)),
        f"All backends, medians (mm). {SHOWN_MEANS}",
        markdown(by_backend(table)),
    ]


def _columns(size: PaperSize) -> str:
    return f"""\
Below, `along`, `cross` and `heading` are signed medians: too far, to the left and counter-clockwise
are positive. `standard / this` is the median over seeds of a seed's own ratio.
`fired`: share of the scans whose model scan the method chose; the rest is its fallback, the
previous scan. `below RBTM`: on how many seeds the error is smaller than that of RBTM with the
circular descriptor; `p` is the signed-rank test of the paired differences, adjusted for the
comparisons of a backend; it needs six seeds. Intervals: bootstrap over seeds. Without noise nothing
is random: sensors with {_words(SHOWN_BEAMS[: size.seeds])} beams take the place of seeds, and
settings were chosen with {_words(CHOICE_BEAMS[: size.choice_seeds])} beams."""


def readme(
    command: str,
    size: PaperSize,
    choices: pd.DataFrame,
    table1: pd.DataFrame,
    ratio: pd.DataFrame,
    opened: pd.DataFrame,
    shown: Mapping[str, list[str]],
    folder: Path,
) -> str:
    """``README.md`` of the results."""
    summary = (
        *in_short(table1, ratio, opened),
        "What the paper does not say (sensor, number of scans, noise, window, threshold, initial "
        "guess, ICP settings) was chosen as listed [below](#what-the-paper-leaves-open).",
    )
    parts = [
        "# The paper, reproduced",
        f"Made by `{command}` on simulated scans. Nothing was tuned toward the paper's numbers: "
        "every method had four settings to choose from, on seeds that are not shown.",
        "## In short",
        _listed(summary),
        "## Table I",
        *short_table(table1, size),
        "Every backend in full: [table1.md](table1.md) and table1.csv; every setting tried: "
        "choices.csv.",
        _left_out(size),
        "### RBTM against its controls",
        against_the_controls(table1),
        "### The paper's descriptor",
        _listed(literal_fires(choices, table1)),
        "### The other backends",
        _listed(other_backends(table1)),
        "## What the paper leaves open",
        _open(size, opened),
        "## Is the standard path curved?",
        _listed(when_curved(table1, ratio, opened, shown, folder)),
        "## The ratio",
        _listed(ratio_in_words(ratio)),
        "![ratio](fig_ratio.png)",
        "## Figures",
        FIGURES,
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _listed(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


FIGURES = """\
Two columns are 17.8 cm wide, one is 8.6 cm. Fonts are embedded, all can be read in grey.

| file (.png, .pdf) | columns | after | here |
|---|---|---|---|
| fig1b | 2 | Fig. 1(b) | the place, two scans, and the paper's descriptor of each |
| fig1c | 2 | Fig. 1(c) | similarity: the paper's descriptor without and with noise, circular |
| fig2 | 2 | Fig. 2 | the model scan in four steps, similarities computed; a whole run |
| fig3 | 1 | Fig. 3 | the simulated corridor and the sensor's view |
| fig4a, fig4b | 1 | Fig. 4(a, b) | standard ICP, RBTM; the seed of the former's median error |
| fig_ratio | 2 | Table I | the ratio over number of scans, noise and ICP distance |

In fig1c (a) and (c) similarity falls with the gap, as in the paper. The block at the end of (a) are
the scans with the corridor's end wall in the sensor's range of 4 m.

Numbers behind them: ratio.csv, open_settings.csv; the runs are below `runs/`."""


def _left_out(size: PaperSize) -> str:
    if not size.left_out:
        return ""
    names = ", ".join(size.left_out)
    return f"Left out here for their time: {names}. Without `--quick` every planar backend is run."


def _open(size: PaperSize, opened: pd.DataFrame) -> str:
    window = window_of(64, size.scans)
    step = 10 * PATH_CM / (size.scans - 1)
    rows = [
        ("sensor", "a laser range finder", "240 deg, 681 beams, range 4 m"),
        ("noise", "not said", f"{NOISE_MM:g} mm on every range; without noise where said"),
        ("number of scans", "not said", f"{size.scans} on 1.8 m, {step:.0f} mm apart"),
        ("place", "drawn in Fig. 3", "a 2 m wide corridor with recesses after it: see fig3"),
        ("window", "4 in the drawing of Fig. 2", f"{window} scans (0.64 m)"),
        ("threshold", "user-defined", "four tries; the chosen one is in table1.md"),
        ("nothing passes", "not said", "fallback to the previous scan"),
        ("descriptor", "eq. (1) to (3)", "those, and the circular one (docs/similarity.md)"),
        ("initial guess", "not said", "the last motion again (`constant_velocity`): no odometry"),
        ("ICP", "point to point, no settings", "Open3D, at most 50 iterations, distance 0.3 m"),
        ("standard way's settings", "none named", "four correspondence distances"),
        ("repetitions", "one number each", f"{size.seeds} seeds, medians"),
    ]
    lines = tabulate(rows, ("open", "the paper", "here"), tablefmt="pipe")
    shown = [
        {
            "changed": row["change"],
            "standard (mm)": number(row.get("standard_mm")),
            "RBTM (mm)": number(row["circular_mm"]),
            "ratio": number(row.get("ratio")),
            "standard along, cross (mm)": _several(row, "along_mm", "cross_mm"),
            "its heading: mean, sd, largest (deg)": _several(
                row, "heading_mean_deg", "heading_sd_deg", "largest_heading_deg"
            ),
        }
        for row in opened.to_dict("records")
    ]
    return (
        f"{lines}\n\nWhat one of them does, all else as above (paper's ICP, distance 0.3 m for "
        f"both, medians over {size.seeds} seeds; open_settings.csv):\n\n"
        f"{markdown(pd.DataFrame(shown))}"
    )


def _several(row: Mapping[Hashable, Any], *keys: str) -> str:
    return ", ".join(filter(None, (number(row.get(f"standard_{key}")) for key in keys)))


def _words(numbers: tuple[int, ...]) -> str:
    return ", ".join(map(str, sorted(numbers)))
