"""What a step is recorded as, and what the steps add up to: declared once."""

from __future__ import annotations

from rbtm_bench.core.column import Column, StepColumn

STEPS = (
    StepColumn("scan", "int", "", "number of the scan in the data set"),
    StepColumn("stamp", "float", "s", "its time"),
    StepColumn("model", "int", "", "number of its model scan"),
    StepColumn("gap", "int", "scans", "scan - model"),
    StepColumn(
        "score", "float", "", "similarity to the model scan, NaN: undefined or not asked for"
    ),
    StepColumn("candidates", "int", "count", "model scans that the selector chose", 0),
    StepColumn(
        "pick",
        "str",
        "",
        "the selector's first pick before the check, once its window is full: oldest, middle or "
        "newest of the members, none (none passed), undefined (no score was defined); empty "
        "without scores",
        "",
    ),
    StepColumn("undefined_scores", "int", "count", "similarities that were undefined", 0),
    StepColumn("rejected", "int", "count", "registrations that check or backend refused", 0),
    StepColumn("registrations", "int", "count", "calls of the backend", 0),
    StepColumn(
        "status",
        "str",
        "",
        "first (the start), registered, fallback (the fallback's registration), skipped (no "
        'candidate, fallback "skip"), still (moved less than `motion_filter`), predicted (every '
        "candidate was rejected), unusable (the backend could not prepare the scan)",
        "first",
    ),
    StepColumn("reason", "str", "", "why this model scan, or why none", ""),
    StepColumn(
        "refused",
        "str",
        "",
        "the model scans whose registrations check or backend refused, and why, a line each: "
        "`812: fitness ...`",
        "",
    ),
    StepColumn("recovered", "str", "", "the restart it came from; empty: from the guess", ""),
    StepColumn("target_scans", "int", "count", "scans that its target was made of"),
    StepColumn("target_points", "int", "count", "points of the target"),
    StepColumn("converged", "bool", "", "whether the library says so; False below 3 inliers"),
    StepColumn("fitness", "float", "share", "source points with a target point in the radius"),
    StepColumn("inlier_rmse_m", "float", "m", "RMS distance of those"),
    StepColumn("iterations", "int", "count", "of the library, where it says"),
    StepColumn("library_fitness", "float", "share", "the library's own fitness"),
    StepColumn("library_rmse_m", "float", "m", "the library's own RMSE"),
    StepColumn("search_score", "float", "share", "mean likelihood where the search ended"),
    StepColumn(
        "search_peak_ratio",
        "float",
        "share",
        "its second peak's score, of the best's; NaN: unasked",
    ),
    StepColumn("localizability_min", "float", "share", "smallest eigenvalue of localizability"),
    StepColumn("localizability", "list", "share", "its eigenvalues, smallest first"),
    StepColumn(
        "weak_direction",
        "list",
        "",
        "eigenvector of the smallest: x, y, rz or x, y, z, rx, ry, rz in the scan's frame",
    ),
    StepColumn("information", "list", "1/m^2, 1/rad^2", "the method's own (6, 6), row by row"),
    StepColumn(
        "kept_guess", "int", "count", "directions along which the guess was kept (degenerate)"
    ),
    StepColumn(
        "restart", "bool", "", "registered to the scan before, which had matched nothing", False
    ),
    StepColumn("reused", "bool", "", "taken from memory or the pair store"),
    StepColumn("t_prepare_s", "float", "s", "preparing the scan and targets", 0.0),
    StepColumn("t_describe_s", "float", "s", "its descriptor", 0.0),
    StepColumn("t_guess_s", "float", "s", "what the guess registers itself", 0.0),
    StepColumn("t_select_s", "float", "s", "scores and selection", 0.0),
    StepColumn("t_register_s", "float", "s", "the backend's registrations", 0.0),
    StepColumn("search_seconds", "float", "s", "of that the search before the one believed"),
    StepColumn("t_check_s", "float", "s", "judging and checking", 0.0),
)
"""The columns of steps.parquet, a row a scan."""

PICKS = {
    "oldest": "the window's oldest member: what `oldest` does",
    "middle": "neither its oldest nor its newest member",
    "newest": "its newest member because that passed",
    "none": "none, because none passed: the fallback is tried",
    "undefined": "none, because no similarity was defined",
}
"""What a selector with scores can do first in a full window."""
DECIDED = ("middle", "newest")
"""Of these what the window alone, or the fallback alone, would not have done."""

COVERAGE = (
    Column(
        "steps",
        "coverage",
        "share",
        "registered scans over all scans but the first",
        "steps",
        table=True,
        screen=True,
        line="share of scans registered",
    ),
)

SUMS = (
    Column(
        "steps",
        "registrations",
        "count",
        "calls of the backend, rejected ones included",
        "steps",
        table=True,
        screen=True,
    ),
    Column(
        "steps",
        "rejected",
        "count",
        "registrations that the check or the backend refused",
        "steps",
        table=True,
        screen=True,
        line="registrations rejected",
    ),
    Column(
        "steps",
        "still",
        "count",
        "scans that moved less than `motion_filter`: not registered, no part of `coverage`",
        "steps",
        table=True,
    ),
    Column(
        "steps",
        "recovered",
        "count",
        "scans registered from another start after the check had refused the guess's",
        "steps",
        table=True,
    ),
    Column(
        "steps",
        "fallbacks",
        "count",
        "scans registered to the fallback's model scan",
        "steps",
        table=True,
        screen=True,
        line="fallbacks",
    ),
    Column(
        "steps",
        "skipped",
        "count",
        "scans left at their predicted pose because no candidate passed and the fallback is "
        '"skip"; those whose candidates were all rejected are not counted here but in '
        "`longest_skip`",
        "steps",
    ),
    Column(
        "steps",
        "longest_skip",
        "scans",
        "most scans in a row without an accepted registration, whatever the reason (skipped, "
        "all rejected, unusable); their poses are predictions ([selection](selection.md))",
        "steps",
    ),
    Column(
        "steps",
        "restarts",
        "count",
        "scans that were matched to the scan before although that had matched nothing, "
        "because nothing had for `restart_after` scans",
        "steps",
    ),
    *(
        Column(
            "steps",
            f"pick_{name}",
            "share",
            f"scans with a full window for which the selector's first pick, before the check, was "
            f"{about}; `null` without scores or full windows",
            "steps, `pick`",
            table=True,
            line=f"first pick: {name}",
        )
        for name, about in PICKS.items()
    ),
    Column(
        "steps",
        "decided",
        "share",
        "`pick_middle` + `pick_newest`: scans for which the threshold chose what neither `oldest` "
        "nor the fallback would have",
        "steps, `pick`",
        table=True,
        screen=True,
        line="decided by the threshold",
    ),
    Column(
        "steps",
        "undefined_scores",
        "count",
        "similarities that were undefined (NaN)",
        "steps",
        line="undefined similarities",
    ),
    Column(
        "steps",
        "reused",
        "share",
        "accepted registrations that were taken from memory or the pair store instead of "
        "being computed; `null` if nothing was registered",
        "steps",
        table=True,
        cost=True,
    ),
    Column(
        "steps",
        "mean_gap",
        "scans",
        "mean of scan - model scan over registered scans; `null` for a system, which has no "
        "model scans (nor `mean_fitness`)",
        "steps",
        table=True,
        screen=True,
        line="mean gap to the model scan",
    ),
    Column(
        "steps",
        "mean_fitness",
        "share",
        "mean over registered scans of the share of source points with a target point within "
        "the radius",
        "our own evaluator, the same for every backend",
    ),
    Column(
        "steps",
        "localizability",
        "share, 0 to 1",
        "median over registered scans of the smallest eigenvalue (below)",
        "our evaluator",
        table=True,
    ),
    Column(
        "steps",
        "degenerate",
        "share",
        "registered scans whose smallest eigenvalue is below 0.01",
        "our evaluator",
        table=True,
        screen=True,
    ),
    Column(
        "cost",
        "ms_per_scan",
        "ms",
        "mean time of prepare, describe, guess, select and register over all scans; the "
        "evaluation and the check of results are left out. What was reused counts with the "
        "time that it took when it was computed, so the number does not depend on what other "
        "runs of a sweep had done before",
        "steps",
        table=True,
        screen=True,
        line="time a scan",
        less_is_better=True,
        cost=True,
    ),
    Column(
        "cost",
        "ms_p50",
        "ms",
        "median time of a scan (percentiles: linear between order statistics)",
        "steps",
        less_is_better=True,
        cost=True,
    ),
    Column(
        "cost",
        "ms_p95",
        "ms",
        "95th percentile of the time of a scan",
        "steps",
        less_is_better=True,
        cost=True,
    ),
    Column(
        "cost",
        "ms_p99",
        "ms",
        "99th percentile of the time of a scan",
        "steps",
        less_is_better=True,
        cost=True,
    ),
    Column(
        "cost",
        "ms_prepare",
        "ms",
        "mean over all scans of preparing the scan for the backend (thinning, normals, trees) "
        "and of putting targets together",
        "steps, `t_prepare_s`",
        less_is_better=True,
        cost=True,
    ),
    Column(
        "cost",
        "ms_describe",
        "ms",
        "mean of the scan's descriptor",
        "steps, `t_describe_s`",
        less_is_better=True,
        cost=True,
    ),
    Column(
        "cost",
        "ms_guess",
        "ms",
        "mean of registrations that the initial guess makes for itself (`guess=chain`) and, "
        "with a similarity that reads the guess, of its prediction for every member of the "
        "window; others cost nothing worth measuring",
        "steps, `t_guess_s`",
        less_is_better=True,
        cost=True,
    ),
    Column(
        "cost",
        "ms_select",
        "ms",
        "mean of scoring the window and choosing candidates",
        "steps, `t_select_s`",
        less_is_better=True,
        cost=True,
    ),
    Column(
        "cost",
        "ms_register",
        "ms",
        "mean of the backend's registrations, rejected ones included",
        "steps, `t_register_s`",
        less_is_better=True,
        cost=True,
    ),
    Column(
        "cost",
        "ms_check",
        "ms",
        "mean of evaluating results (fitness, localizability), of `guess_along_degenerate` "
        "and of the check; next to nothing for what was reused, so not to be compared between "
        "runs that shared",
        "steps, `t_check_s`",
        less_is_better=True,
        cost=True,
    ),
    Column(
        "cost",
        "real_time_factor",
        "ratio",
        "median time between the stamps of successive scans, in order of time, over "
        "`ms_per_scan`; above 1 the method keeps up with the sensor, as the data set has it: "
        "a stride of 10 makes it ten times as large, and a simulation's stamps are 0.1 s "
        "apart by convention. `null` where stamps do not say (one scan, or most of them "
        "equal)",
        "steps, `stamp`",
        cost=True,
    ),
    Column(
        "cost",
        "peak_memory_mb",
        "MB",
        "most memory (10^6 bytes) that the process of the run had resident at once, until the "
        "last scan was done: Python and all libraries (measured: 370 MB for 30 scans, "
        "whatever the backend), the data set and, in a comparison or sweep, what the worker "
        "keeps from earlier runs (`pairs.memory_mb`). For a method's own need compare single "
        "runs with `pairs.store=off`",
        "Linux: `VmHWM`; else `ru_maxrss`, which on Linux a process inherits from its parent",
        cost=True,
    ),
)
