"""The findings of scripts/reproduce_paper.py, in sentences computed from its tables: they say what
the numbers say, whatever they are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from rbtm_bench.studies.paper.figures import THEIR_RATIO
from rbtm_bench.studies.paper.plan import PAPER_BACKEND, UNCHANGED
from rbtm_bench.studies.paper.tables import PARTS, against_controls, between, held, number, read
from rbtm_bench.studies.paper.ways import NAMES, NOISE_MM, PATH_CM

BENT_DEG = 10.0
"""A path that turned evenly by this much by its end is 16 cm beside the straight one after 1.8 m:
seen at a glance."""
RARE = 0.05
"""A method that chooses fewer of the model scans is its fallback."""
SAME = 1.05
"""Ratios up to this are called equal."""
SHOWN_MEANS = (
    "(+) and (-) behind a control: RBTM with the circular descriptor is shown better or worse than "
    "it, by a signed-rank test over the seeds (six at least) with Holm's correction within a "
    "backend; no mark: not shown."
)


def in_short(table1: pd.DataFrame, ratio: pd.DataFrame, opened: pd.DataFrame) -> list[str]:
    """What the paper claims, and what our runs give."""
    by_way = table1[table1["backend"] == PAPER_BACKEND].set_index("way")
    ours, standard, literal = by_way.loc["circular"], by_way.loc["standard"], by_way.loc["literal"]
    low, high = ours["standard_over_low"], ours["standard_over_high"]
    inside = ""
    if between(low, high):
        where = "in" if low <= THEIR_RATIO <= high else "outside"
        inside = f"; the paper's {THEIR_RATIO:.0f} lies {where} it"
    share = literal["fired"] / max(literal["scans"], 1)
    return [
        "**The paper claims** that a model scan chosen by similarity makes the final error "
        f"{THEIR_RATIO:.0f} times smaller: 1076.3 mm with the standard way (always the previous "
        "scan) and 7.423 mm with RBTM, one number each, on a straight path of 1.8 m.",
        f"**We find** {number(standard['median_error_mm'])} and {number(ours['median_error_mm'])} "
        f"mm with the same matcher: RBTM's error is {_times(ours['standard_over_this'])} the "
        f"standard way's ({_interval(low, high)}{inside}). That is RBTM with the circular "
        f"descriptor. With the paper's own, which chooses {share:.1%} of the model scans at "
        f"{NOISE_MM:g} mm of noise, it ends {number(literal['median_error_mm'])} mm off.",
        _similarity_or_gap(table1, by_way),
        _path(by_way, opened),
        f"**Number of scans, noise and ICP distance** move the ratio from "
        f"{number(ratio['standard_over_circular'].min())} to "
        f"{number(ratio['standard_over_circular'].max())}, median "
        f"{number(ratio['standard_over_circular'].median())} ([figure](#the-ratio)).",
    ]


def _similarity_or_gap(table1: pd.DataFrame, by_way: pd.DataFrame) -> str:
    """The heart of it: is it similarity that helps, or any larger gap?"""
    rows = against_controls(table1)
    better, worse = ((rows["verdict"] == verdict).sum() for verdict in ("better", "worse"))
    lower = int((rows["rbtm_mm"] < rows["control_mm"]).sum())
    each = ", ".join(
        f"{NAMES[control][1]} {number(by_way.loc[control, 'median_error_mm'])} mm"
        for control in dict.fromkeys(rows["control"])
    )
    text = (
        "**Is it similarity, or any larger gap?** With the same matcher, controls that know "
        f"nothing of similarity end this far off: {each}. Over all backends RBTM's median is the "
        f"smaller one in {lower} of {len(rows)} comparisons with a control"
    )
    if not rows["p_holm"].notna().any():
        return f"{text}; there are too few seeds to test that."
    verdict = (
        "On this corridor a larger gap is what helps; that similarity chooses it better is not "
        "shown."
        if better <= worse
        else "On this corridor similarity chooses the model scan better than a gap does."
    )
    return f"{text}; it is shown better in {better} and worse in {worse}. **{verdict}**"


def _path(by_way: pd.DataFrame, opened: pd.DataFrame) -> str:
    """The curved path in a sentence or two."""
    row = by_way.loc["standard"]
    straight = row["largest_heading_deg"] < BENT_DEG
    words = "straight and too short" if straight and row["along_mm"] < 0 else "straight"
    if not straight:
        words = f"curved in some runs (turned by up to {number(row['largest_heading_deg'])} deg)"
    turned = opened.set_index("change")["standard_largest_heading_deg"].dropna()
    bent = list(turned.index[turned >= BENT_DEG])
    when = (
        f" It curves with {' and with '.join(f'({_plain(name)})' for name in bent)}."
        if bent
        else ""
    )
    none = " None of the settings that we changed bends it." if straight and not bent else ""
    return (
        f"**The paper's standard path is curved. Ours is {words}**: along "
        f"{number(row['along_mm'])} mm, cross {number(row['cross_mm'])} mm, heading "
        f"{number(row['heading_deg'])} deg.{when}{none} [Why](#is-the-standard-path-curved)."
    )


def _plain(change: str) -> str:
    """ "noise: 30 mm, sensor: 40 deg" without the colons."""
    return change.replace(": ", " ")


def other_backends(table1: pd.DataFrame) -> list[str]:
    """What the model scan is worth to the other matchers, and what no noise does to them."""
    medians = table1.pivot(index="backend", columns="way", values="median_error_mm")
    less = medians["standard"] / medians["circular"]
    lines = [
        f"The standard way's median error is {number(less.min())} ({less.idxmin()}) to "
        f"{number(less.max())} ({less.idxmax()}) times that of RBTM, circular: what the model scan "
        f"is worth depends on the matcher. The best standard way is {medians['standard'].idxmin()} "
        f"with {number(medians['standard'].min())} mm."
    ]
    worse = medians.index[medians["standard_clean"] > medians["standard"]]
    still = medians.index[medians["standard_clean"] > 0.99 * 10 * PATH_CM]
    text = (
        f"Without noise the standard way is worse than with it at {len(worse)} of {len(medians)} "
        "backends"
    )
    stands = f"; {' and '.join(still)} then do not move at all" if len(still) else ""
    if "plicp" in still:
        stands += ": the few points that show the motion are what their trimming takes for outliers"
    return [*lines, f"{text}{stands}."]


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
        verdict = "**it never fires**" if row["fired"] == 0 else f"it fires on {share:.1%} of them"
        if 0 < share < RARE:
            verdict = f"**it all but never fires** ({share:.1%} of them)"
        if share < RARE:
            verdict += "; all other scans fall back to the previous one, the standard way"
        words.append(
            f"{name}: of {tried['scans'].max()} scans on which thresholds were tried, it chose the "
            f"model scan of {each}. On the shown data, with its chosen {row['setting']}, it chose "
            f"that of {row['fired']} of {row['scans']}: {verdict}. The final error is "
            f"{number(row['median_error_mm'])} mm, {_times(row['standard_over_this'])} the "
            "standard way's on the same data."
        )
    return words


def _times(ratio: float) -> str:
    """ "3.4 times smaller than", "1.2 times larger than", "the same (within 5%) as"."""
    if not math.isfinite(ratio):
        return "not comparable with"
    if max(ratio, 1 / ratio) <= SAME:
        return "the same (within 5%) as"
    smaller = f"{number(ratio)} times smaller than"
    return smaller if ratio > 1 else f"{number(1 / ratio)} times larger than"


def against_the_controls(table1: pd.DataFrame) -> str:
    """RBTM beside each of its controls over the backends."""
    rows = against_controls(table1)
    tested = bool(rows["p_holm"].notna().any())
    parts = []
    for control, group in rows.groupby("control", sort=False):
        lower = int((group["rbtm_mm"] < group["control_mm"]).sum())
        verdicts = list(group["verdict"])
        better, worse = verdicts.count("better"), verdicts.count("worse")
        test = f" (shown better at {better}, shown worse at {worse})" if tested else ""
        parts.append(f"{NAMES[str(control)][1]} at {lower}{test}")
    end = "" if tested else " With fewer than six seeds nothing is tested."
    return (
        f"Backends, of {rows['backend'].nunique()}, at which RBTM (circular) has a smaller median "
        f"error than a control that knows nothing of similarity: {'; '.join(parts)}.{end} A random "
        "gap draws the very gaps that RBTM chose on the same data, in random order."
    )


def when_curved(
    table1: pd.DataFrame,
    ratio: pd.DataFrame,
    opened: pd.DataFrame,
    shown: Mapping[str, list[str]],
    folder: Path,
) -> list[str]:
    """Along, cross and heading of the standard way: whether it curves, when, and why."""
    standard = table1[table1["way"].str.startswith("standard")]
    row = standard[standard["backend"] == PAPER_BACKEND].set_index("way").loc["standard"]
    changed = opened.dropna(subset=["standard_mm"]).set_index("change")
    answer = "No" if row["largest_heading_deg"] < BENT_DEG else "In some runs"
    short = "short" if row["along_mm"] < 0 else "long"
    matcher = standard.loc[standard["largest_heading_deg"].idxmax()]
    lines = [
        f"**{answer}, not in Table I.**" if answer == "No" else f"**{answer} of Table I.**",
        _when_bent(changed),
        _why_short(ratio, shown, folder),
        _noise_turns(changed),
        _size_alone(ratio),
    ]
    lines[0] += (
        f" With the paper's ICP the path ends {number(row['along_mm'])} mm along, "
        f"{number(row['cross_mm'])} mm across, and turned by {number(row['heading_deg'])} deg "
        f"(medians; {number(row['largest_heading_deg'])} deg at most): too {short}, not bent. "
        f"Of all matchers {matcher['backend']} turns it most, by "
        f"{number(matcher['largest_heading_deg'])} deg at most. From {BENT_DEG:g} deg on one would "
        "see it."
    )
    return [line for line in lines if line]


def _when_bent(changed: pd.DataFrame) -> str:
    """The changed settings with which the standard path is curved, and what RBTM does with them."""
    turned = changed["standard_largest_heading_deg"].drop(UNCHANGED).sort_values(ascending=False)
    fields = changed[changed.index.str.fullmatch(r"sensor: \d+ deg")]
    by_field = ", ".join(
        f"{number(row['standard_largest_heading_deg'])} deg with {str(name)[8:]}"
        for name, row in fields.iterrows()
    )
    parts = []
    for name in turned.index[turned >= BENT_DEG]:
        row = changed.loc[name]
        share = row["circular_fired"] / max(row["circular_scans"], 1)
        parts.append(
            f"({_plain(str(name))}): by {number(row['standard_largest_heading_deg'])} deg and "
            f"{number(row['standard_largest_cross_mm'])} mm across at most, mean "
            f"{number(row['standard_heading_mean_deg'])} deg, standard deviation "
            f"{number(row['standard_heading_sd_deg'])} deg over seeds. RBTM turns there too, by "
            f"{number(row['circular_largest_heading_deg'])} deg at most; it fires on {share:.0%} "
            "of the scans"
        )
    text = f"**When does it curve?** With {'; with '.join(parts)}."
    if not parts:
        text = (
            "**When does it curve?** With none of the changed settings above: at most "
            f"{number(turned.max())} deg ({turned.idxmax()})."
        )
    widest = number(changed.loc[UNCHANGED, "standard_largest_heading_deg"])
    return (
        f"{text} The narrower the field of view, the larger the largest turn: {widest} deg with "
        f"240 deg, {by_field}."
        if fields["standard_largest_heading_deg"].is_monotonic_increasing
        else f"{text} Largest turn by field of view: {widest} deg with 240 deg, {by_field}."
    )


def _size_alone(ratio: pd.DataFrame) -> str:
    """Whether the paper's magnitude occurs, and whether along the path or across it."""
    near = ratio[(ratio["standard_mm"] > 900) & (ratio["standard_mm"] < 1250)]
    if near.empty:
        return "An error of the paper's size (0.9 to 1.25 m) occurs in no cell of the grid below."
    row = near.loc[(near["standard_mm"] - 1076.3).abs().idxmin()]
    along, cross, turn = (number(row[f"standard_{part}"]) for part in PARTS)
    return (
        "An error of the paper's size does not need a curved path: with "
        f"{row['scans']:.0f} scans, {row['noise_mm']:g} mm noise and an ICP distance of "
        f"{row['distance_m']:g} m the standard way ends {number(row['standard_mm'])} mm off: "
        f"{along} mm along, {cross} mm across, turned by {turn} deg."
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
    grows = "grows with the noise" if spread == sorted(spread) else "is not in step with the noise"
    row = by_change.loc[UNCHANGED]
    mean, sd, runs = (
        float(row[f"standard_{key}"]) for key in ("heading_mean_deg", "heading_sd_deg", "runs")
    )
    error = sd / math.sqrt(runs)
    part = (
        "so a part of it is the place's own, the same for every seed"
        if abs(mean) > 2 * error
        else "not distinguishable from no turn at all"
    )
    return (
        f"The final heading's standard deviation over seeds {grows}: {listed}. At {NOISE_MM:g} mm "
        f"its mean is {mean:.2f} deg, standard error {error:.2f}: {part}."
    )


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
        "**Why short?** The walls beside the robot hold its heading and its place across the "
        "corridor, but hardly its way along it: in the run of fig4a the least held direction is "
        f"{number(angle)} deg off the axis (median over scans), with a localizability of "
        f"{weakest:.2f} against {strongest:.2f} in the best held one. Every step loses a little, "
        f"so more scans on the same 1.8 m lose more: {steps} scans ({noise:g} mm noise, ICP "
        f"distance {distance:g} m). A sensor that looks ahead only does not see the walls beside "
        "it, and the heading drifts too."
    )


def ratio_in_words(ratio: pd.DataFrame) -> list[str]:
    """The picture in words."""
    value, gap = ratio["standard_over_circular"], ratio["standard_over_fixed_gap"]
    best, worst = ratio.loc[value.idxmax()], ratio.loc[value.idxmin()]
    return [
        f"Standard / RBTM over {len(ratio)} cells (paper's ICP): median {number(value.median())}, "
        f"from {number(value.min())} ({_cell(worst)}) to {number(value.max())} ({_cell(best)}). "
        f"{int((value >= THEIR_RATIO).sum())} cells reach the paper's {THEIR_RATIO:.0f}; in "
        f"{int((value < 1).sum())} the standard way is better.",
        f"By number of scans (median over the other axes): {_by(ratio, 'scans', '')}; by noise: "
        f"{_by(ratio, 'noise_mm', ' mm')}; by ICP distance: {_by(ratio, 'distance_m', ' m')}.",
        f"A fixed gap in the same cells: median {number(gap.median())}, from {number(gap.min())} "
        f"to {number(gap.max())}; its ratio is the larger one in {int((gap > value).sum())} of "
        f"{len(ratio)} cells. By ICP distance: "
        f"{_by(ratio, 'distance_m', ' m', 'standard_over_fixed_gap')}. Both methods' settings were "
        "chosen with 0.3 m and kept for all cells.",
    ]


def _by(ratio: pd.DataFrame, axis: str, unit: str, of: str = "standard_over_circular") -> str:
    medians = ratio.groupby(axis)[of].median()
    return ", ".join(f"{number(value)} ({place:g}{unit})" for place, value in medians.items())


def _cell(row: pd.Series) -> str:
    return f"{row['scans']:.0f} scans, {row['noise_mm']:g} mm, {row['distance_m']:g} m"


def _interval(low: float | None, high: float | None) -> str:
    text = between(low, high)
    return f"95% interval {text}" if text else "too few seeds for an interval"
