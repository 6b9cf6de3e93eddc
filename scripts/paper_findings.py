"""What scripts/reproduce_paper.py found, in sentences computed from its tables: they say what the
numbers say, whatever they are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import pandas as pd
from paper_figures import THEIR_RATIO
from paper_plan import NOISE_MM, PAPER_BACKEND, UNCHANGED
from paper_tables import PARTS, against_controls, between, held, markdown, number, read

BENT_DEG = 10.0
"""A path that turned evenly by this much by its end is 16 cm beside the straight one after 1.8 m:
seen at a glance."""
RARE = 0.05
"""A method that chooses fewer of the model scans is its fallback."""
SAME = 1.05
"""Ratios up to this are called equal."""


def main_result(table1: pd.DataFrame) -> list[str]:
    """The paper's comparison with its matcher, and with the others."""
    here = table1[table1["backend"] == PAPER_BACKEND].set_index("way")
    ours, standard = here.loc["circular"], here.loc["standard"]
    medians = table1.pivot(index="backend", columns="way", values="median_error_mm")
    less = medians["standard"] / medians["circular"]
    return [
        f"With the paper's ICP RBTM with the circular descriptor ends "
        f"{number(ours['median_error_mm'])} mm off, {_times(ours['standard_over_this'])} the "
        f"standard way with {number(standard['median_error_mm'])} mm "
        f"({_interval(ours['standard_over_low'], ours['standard_over_high'])}). The paper: 7.423 "
        f"and 1076.3 mm, {THEIR_RATIO:.0f} times.",
        f"Over the {len(less)} backends the standard way's median error is {number(less.min())} "
        f"({less.idxmin()}) to {number(less.max())} ({less.idxmax()}) times that of RBTM: what the "
        "model scan is worth depends on the matcher. The best standard way, "
        f"{medians['standard'].idxmin()}, ends {number(medians['standard'].min())} mm off.",
    ]


def literal_fires(choices: pd.DataFrame, table1: pd.DataFrame) -> list[str]:
    """How often the paper's descriptor chose the model scan, from the fallbacks of all runs."""
    words = []
    for way, name in (
        ("literal", f"With {NOISE_MM:g} mm noise"),
        ("literal_clean", "Without noise"),
    ):
        tried = choices[(choices["way"] == way) & (choices["backend"] == PAPER_BACKEND)]
        row = table1[(table1["way"] == way) & (table1["backend"] == PAPER_BACKEND)].iloc[0]
        each = ", ".join(
            f"{line['fired']} at {line['setting'].rpartition(' ')[2]}"
            for line in tried.to_dict("records")
        )
        share = row["fired"] / max(row["scans"], 1)
        verdict = "**it never fires**" if row["fired"] == 0 else f"it fires on {share:.1%}"
        if 0 < share < RARE:
            verdict = f"**it all but never fires** ({share:.1%}, by chance)"
        if share < RARE:
            verdict += ", and every other scan falls back to the previous one: the standard way"
        words.append(
            f"{name} the paper's own descriptor chose the model scan of so many of "
            f"{tried['scans'].max()} scans on which thresholds were tried: {each}; of those shown, "
            f"at its chosen {row['setting']}, {row['fired']} of {row['scans']}: {verdict}. It ends "
            f"{number(row['median_error_mm'])} mm off, {_times(row['standard_over_this'])} the "
            "standard way with its chosen ICP distance on the same data."
        )
    return words


def _times(ratio: float) -> str:
    """ "3.4 times less than", "1.2 times more than", "as much as (within 5 %)"."""
    if not math.isfinite(ratio):
        return "not comparable with"
    if max(ratio, 1 / ratio) <= SAME:
        return "as much (within 5 %) as"
    return (
        f"{number(ratio)} times less than" if ratio > 1 else f"{number(1 / ratio)} times more than"
    )


def against_the_controls(table1: pd.DataFrame) -> str:
    """RBTM beside its controls at every backend."""
    rows = against_controls(table1)
    tested = bool(rows["p_holm"].notna().any())
    told, shown = [], {"backend": list(dict.fromkeys(rows["backend"]))}
    shown["RBTM (mm)"] = [number(v) for v in rows.drop_duplicates("backend")["rbtm_mm"]]
    marks = {"better": " (+)", "worse": " (-)", "": ""}
    for control, here in rows.groupby("control", sort=False):
        lower, verdicts = int((here["rbtm_mm"] < here["control_mm"]).sum()), list(here["verdict"])
        better, worse = verdicts.count("better"), verdicts.count("worse")
        test = f" (shown at {better}, the reverse at {worse})" if tested else ""
        told.append(f"{control}: at {lower}{test}")
        shown[str(control)] = [
            number(mm) + marks[verdict]
            for mm, verdict in zip(here["control_mm"], verdicts, strict=True)
        ]
    test = (
        "Shown means by a signed-rank test over the seeds, adjusted for a backend's comparisons: "
        "(+) where RBTM is better, (-) where it is worse."
        if tested
        else "With fewer than six seeds nothing is tested."
    )
    return (
        "**RBTM (circular) against controls that know nothing of similarity.** At how many of "
        f"{len(shown['backend'])} backends is its median error the smaller one? Than that of "
        f"{'; '.join(told)}. {test}\n\n{markdown(pd.DataFrame(shown))}"
    )


def why_straight(
    table1: pd.DataFrame,
    ratio: pd.DataFrame,
    opened: pd.DataFrame,
    shown: Mapping[str, list[str]],
    folder: Path,
) -> list[str]:
    """Along, cross and heading of the standard way: whether it curves, when, and why."""
    standard = table1[table1["way"].str.startswith("standard")]
    by_backend = standard[standard["way"] == "standard"].set_index("backend")
    here = by_backend.loc[PAPER_BACKEND]
    changed = opened.dropna(subset=["standard_mm"]).set_index("change")
    answer = "no" if here["largest_heading_deg"] < BENT_DEG else "in some runs"
    short = "short" if here["along_mm"] < 0 else "long"
    matcher = standard.loc[standard["largest_heading_deg"].idxmax()]
    lines = [
        f"The paper's standard path is curved. Ours in Table I: **{answer}**. With the paper's ICP "
        f"it ends {number(here['along_mm'])} mm along, {number(here['cross_mm'])} mm across and "
        f"{number(here['heading_deg'])} deg turned (up to {number(here['largest_heading_deg'])}): "
        f"too {short} rather than bent. Of all its matchers {matcher['backend']} turns it most, by "
        f"up to {number(matcher['largest_heading_deg'])} deg; {BENT_DEG:g} would be seen.",
        _when_bent(changed),
        _why_short(ratio, shown, folder),
        _noise_turns(changed),
        _size_alone(ratio),
    ]
    return [line for line in lines if line]


def _when_bent(changed: pd.DataFrame) -> str:
    """The changed settings with which the standard path is curved, and what RBTM does there."""
    turned = changed["standard_largest_heading_deg"].drop(UNCHANGED).sort_values(ascending=False)
    fields = changed[changed.index.str.fullmatch(r"sensor: \d+ deg")]
    by_field = ", ".join(
        f"{number(row['standard_largest_heading_deg'])} deg with {str(name)[8:]}"
        for name, row in fields.iterrows()
    )
    told = []
    for name in turned.index[turned >= BENT_DEG]:
        row = changed.loc[name]
        share = row["circular_fired"] / max(row["circular_scans"], 1)
        told.append(
            f"{name} (turned {number(row['standard_heading_mean_deg'])} +- "
            f"{number(row['standard_heading_sd_deg'])} deg over seeds, up to "
            f"{number(row['standard_largest_cross_mm'])} mm across; RBTM, which fires on "
            f"{share:.0%} of the scans there, up to {number(row['circular_largest_heading_deg'])} "
            "deg)"
        )
    if not told:
        text = (
            f"Of the changed settings above none bends it: at most {number(turned.max())} deg "
            f"({turned.idxmax()})."
        )
    else:
        text = f"It is curved with {'; '.join(told)}."
    widest = number(changed.loc[UNCHANGED, "standard_largest_heading_deg"])
    return (
        f"{text} What decides is the field of view: largest turn {widest} deg as it is, {by_field}."
    )


def _size_alone(ratio: pd.DataFrame) -> str:
    """Whether the paper's magnitude occurs, and whether along the path or across it."""
    near = ratio[(ratio["standard_mm"] > 900) & (ratio["standard_mm"] < 1250)]
    if near.empty:
        return "An error of the paper's size (0.9 to 1.25 m) occurs in no cell of the grid below."
    row = near.loc[(near["standard_mm"] - 1076.3).abs().idxmin()]
    along, cross, turn = (number(row[f"standard_{part}"]) for part in PARTS)
    return (
        f"The paper's size of error alone does not make its path: with {row['scans']:.0f} scans, "
        f"{row['noise_mm']:g} mm noise and a distance of {row['distance_m']:g} m the standard way "
        f"ends {number(row['standard_mm'])} mm off, {along} mm along, {cross} mm across and "
        f"{turn} deg turned."
    )


def _noise_turns(by_change: pd.DataFrame) -> str:
    """Chance or place: the spread of the final heading over seeds, and its mean."""
    names = {
        "noise: 3 mm": 3.0,
        UNCHANGED: NOISE_MM,
        "noise: 30 mm": 30.0,
        "noise: 50 mm": 50.0,
    }
    known = {mm: by_change.loc[name] for name, mm in names.items() if name in by_change.index}
    spread = [float(row["standard_heading_sd_deg"]) for row in known.values()]
    if len(spread) < 2 or not all(math.isfinite(value) for value in spread):
        return ""
    listed = ", ".join(
        f"{number(sd)} deg at {mm:g} mm" for mm, sd in zip(known, spread, strict=True)
    )
    text = f"What turns it is noise: the final heading spreads over seeds by {listed}."
    if spread != sorted(spread):
        text = f"The final heading spreads over seeds by {listed}: not in step with the noise."
    row = by_change.loc[UNCHANGED]
    mean, sd, runs = (
        float(row[f"standard_{key}"]) for key in ("heading_mean_deg", "heading_sd_deg", "runs")
    )
    error = sd / math.sqrt(runs)
    part = (
        "a small part is the place's own, the same for every seed"
        if abs(mean) > 2 * error
        else "not distinguishable from no turn at all"
    )
    return f"{text} Its mean is {mean:.2f} +- {error:.2f} deg (standard error): {part}."


def _why_short(ratio: pd.DataFrame, shown: Mapping[str, list[str]], folder: Path) -> str:
    """Which direction the matched walls hold, and what more steps of the same path do."""
    runs = read(folder, shown["standard"])
    if not runs:
        return ""
    weakest, strongest, angle = held(runs[0])
    noise = NOISE_MM if (ratio["noise_mm"] == NOISE_MM).any() else ratio["noise_mm"].max()
    distance = sorted(ratio["distance_m"], key=lambda d: abs(d - 0.3))[0]
    line = ratio[(ratio["noise_mm"] == noise) & (ratio["distance_m"] == distance)]
    steps = ", ".join(
        f"{number(mm)} mm with {scans}"
        for scans, mm in zip(line["scans"], line["standard_mm"], strict=True)
    )
    return (
        "Why: the walls beside the robot hold the heading, the way along is held least. In the run "
        f"of fig4a the least held direction lies {number(angle)} deg off the corridor's axis "
        f"(median over scans) and {weakest:.2f} of the matched points oppose it, {strongest:.2f} "
        "the best held one. What a step loses along is lost again with every further step on the "
        f"same 1.8 m: {steps} scans ({noise:g} mm noise, distance {distance:g} m). A sensor that "
        "looks ahead only sees the walls beside it no more, and the heading goes too."
    )


def ratio_in_words(ratio: pd.DataFrame) -> list[str]:
    """The picture in words."""
    value = ratio["standard_over_circular"]
    best, worst = ratio.loc[value.idxmax()], ratio.loc[value.idxmin()]
    gap = ratio["standard_over_fixed_gap"]
    lines = [
        f"Standard / RBTM over {len(ratio)} cells (paper's ICP): median {number(value.median())}, "
        f"from {number(value.min())} ({_cell(worst)}) to {number(value.max())} ({_cell(best)}); "
        f"{int((value >= THEIR_RATIO).sum())} cells reach the paper's {THEIR_RATIO:.0f}, in "
        f"{int((value < 1).sum())} the standard way is better.",
        "By number of scans (median over the other axes): "
        f"{_by(ratio, 'scans', '')}; by noise: {_by(ratio, 'noise_mm', ' mm')}; by distance: "
        f"{_by(ratio, 'distance_m', ' m')}.",
        f"A fixed gap in the same cells: median {number(gap.median())}, {number(gap.min())} to "
        f"{number(gap.max())}; its ratio is the larger one in {int((gap > value).sum())} of "
        f"{len(ratio)} cells.",
    ]
    return lines


def _by(ratio: pd.DataFrame, axis: str, unit: str) -> str:
    medians = ratio.groupby(axis)["standard_over_circular"].median()
    return ", ".join(f"{number(value)} ({place:g}{unit})" for place, value in medians.items())


def _cell(row: pd.Series) -> str:
    return f"{row['scans']:.0f} scans, {row['noise_mm']:g} mm, {row['distance_m']:g} m"


def _interval(low: float | None, high: float | None) -> str:
    text = between(low, high)
    return f"95 % interval {text}" if text else "too few seeds for an interval"
