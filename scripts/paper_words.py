"""The words of scripts/reproduce_paper.py: its README, the page of Table I, and its last lines."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from paper_findings import (
    against_the_controls,
    literal_fires,
    main_result,
    ratio_in_words,
    why_straight,
)
from paper_plan import (
    CHOICE_BEAMS,
    FIRST_CHOICE,
    NOISE_MM,
    PATH_CM,
    SHOWN_BEAMS,
    Size,
    window_of,
)
from paper_tables import between, markdown, number, summary
from tabulate import tabulate


def final_words(table: pd.DataFrame, size: Size) -> str:
    """Table I for the terminal, a method a line."""
    short = summary(table)
    headers = [str(name).replace(" ", "\n").replace("_", "\n") for name in short]
    align = ["left", "right", "right", "left"] + ["right"] * (len(short.columns) - 4)
    text = tabulate(
        short.to_numpy().tolist(), headers, tablefmt="simple", disable_numparse=True, colalign=align
    )
    return "\n".join([_title(size), text])


def _title(size: Size) -> str:
    return (
        f"Table I: median final position error (mm) over {size.seeds} seeds; path "
        f"{10 * PATH_CM:.0f} mm, {size.scans} scans, {NOISE_MM:g} mm noise unless said; "
        f"settings tried: on seeds {FIRST_CHOICE} to {FIRST_CHOICE + size.choice_seeds - 1}"
    )


def table_page(table: pd.DataFrame, size: Size) -> str:
    """``table1.md``: Table I in short, then every backend in full."""
    parts = ["# Table I", _title(size), markdown(summary(table)), _columns(size)]
    for backend, here in table.groupby("backend", sort=False):
        rows = [
            {
                "method": row["method"], "chosen setting": row["setting"], "tried": row["tried"],
                "runs": row["runs"], "median (mm)": number(row["median_error_mm"]),
                "95 % interval": between(row["low_mm"], row["high_mm"]),
                "largest": number(row["largest_error_mm"]), "along (mm)": number(row["along_mm"]),
                "cross (mm)": number(row["cross_mm"]), "heading (deg)": number(row["heading_deg"]),
                "largest heading": number(row["largest_heading_deg"]),
                "standard / this": number(row["standard_over_this"]),
                "95 % of it": between(row["standard_over_low"], row["standard_over_high"]),
                "fired": f"{row['fired'] / max(row['scans'], 1):.1%}",
                "mean gap": number(row["mean_gap"]),
                "below RBTM": "" if pd.isna(row["smaller_than_rbtm"])
                else f"{row['smaller_than_rbtm']:.0f} of {row['runs']}",
                "p (Holm)": "" if pd.isna(row["p_holm"]) else f"{row['p_holm']:.2g}",
                "ms a scan": number(row["ms_per_scan"]),
            }
            for row in here.to_dict("records")
        ]  # fmt: skip
        parts += [f"## {backend}", markdown(pd.DataFrame(rows))]
    return "\n\n".join(parts) + "\n"


def _columns(size: Size) -> str:
    return f"""\
`along`, `cross` and `heading` are signed medians: too far, to the left and counter-clockwise are
positive. `standard / this`: errors on the same data, the median over seeds of a seed's own ratio.
`fired`: share of the scans whose model scan the method chose; the rest is its fallback, the
previous scan. `below RBTM`: on how many seeds the error is smaller than that of RBTM with the
circular descriptor; `p` is the signed-rank test of the paired differences, adjusted for the
comparisons of a backend; it needs six seeds. Intervals: bootstrap over seeds. Without noise nothing
is random: sensors with {_words(SHOWN_BEAMS[: size.seeds])} beams take the place of seeds, and
settings were chosen with {_words(CHOICE_BEAMS[: size.choice_seeds])} beams."""


def readme(
    command: str,
    size: Size,
    choices: pd.DataFrame,
    table1: pd.DataFrame,
    ratio: pd.DataFrame,
    opened: pd.DataFrame,
    shown: Mapping[str, list[str]],
    folder: Path,
) -> str:
    """``README.md`` of the results."""
    parts = [
        "# The paper, reproduced",
        f"Made by `{command}` on simulated scans. Nothing was tuned toward the paper's numbers: "
        "every method had four settings to choose from, on seeds that are not shown.",
        "## Table I",
        markdown(summary(table1)),
        f"{_title(size)}. Of the other backends the medians; all of it is in "
        "[table1.md](table1.md) and table1.csv, every try in choices.csv.",
        _left_out(size, table1),
        "### What it says",
        "\n".join(f"- {line}" for line in (*main_result(table1), *literal_fires(choices, table1))),
        against_the_controls(table1),
        "## What the paper leaves open",
        _open(size, opened),
        "## Is the standard path curved?",
        "\n".join(f"- {line}" for line in why_straight(table1, ratio, opened, shown, folder)),
        "## The ratio",
        "\n".join(f"- {line}" for line in ratio_in_words(ratio)),
        "![ratio](fig_ratio.png)",
        "## Figures",
        FIGURES,
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


FIGURES = """\
| file (.png, .pdf) | after | here |
|---|---|---|
| fig1b | Fig. 1(b) | the place, two scans, and the paper's descriptor of each |
| fig1c | Fig. 1(c) | similarity: paper's descriptor with and without noise, circular |
| fig2 | Fig. 2 | the model scan in four steps, similarities computed; a whole run |
| fig3 | Fig. 3 | the simulated corridor and the sensor's view |
| fig4a, fig4b | Fig. 4(a, b) | standard ICP and RBTM, at the seed of the former's median error |
| fig_ratio | Table I | the ratio over number of scans, noise and correspondence distance |

Numbers behind them: ratio.csv, open_settings.csv; the runs are below `runs/`."""


def _left_out(size: Size, table1: pd.DataFrame) -> str:
    if not size.left_out:
        cost = table1[table1["way"] == "standard"].set_index("backend")["ms_per_scan"]
        slow = str(cost.idxmax())
        rest = cost.drop(slow)
        if rest.empty:
            return ""
        return (
            f"The slowest backend is {slow}, {number(cost[slow])} ms a scan with the previous "
            f"scan as model (the others {number(rest.min())} to {number(rest.max())}); "
            "`--quick` leaves it and some others out."
        )
    names = ", ".join(size.left_out)
    return f"Left out here for their time: {names}. Without `--quick` every planar backend is run."


def _open(size: Size, opened: pd.DataFrame) -> str:
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
        ("repetitions", "one run", f"{size.seeds} seeds, medians"),
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
