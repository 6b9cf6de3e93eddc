"""The answer in a paragraph: who won, who is tied, what it costs, which alarms stand, what next."""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

from rbtm_bench.report import better, render, rotation
from rbtm_bench.report.best_settings import ERRORS, NO_METHODS, champion
from rbtm_bench.report.frame import MethodRuns, table_of
from rbtm_bench.report.render import is_empty, is_numeric_cell, three_digits
from rbtm_bench.report.replicates import SHIFTED, draw_of, trajectory_of
from rbtm_bench.report.verdict import label
from rbtm_bench.runs.stored import Run

MOST = 12
"""Lines of the paragraph."""
OF_DATA = 6
"""Of these about who won, on all data sets together."""
NAMED = 3
"""Methods that a line names."""
HALF = 0.5
"""A run that registered a smaller share of its scans is dead: its poses are predictions."""


def answer(methods: Sequence[MethodRuns], where: str) -> list[str]:
    """At most ``MOST`` lines, each tied to a column, on methods whose runs are in ``where``."""
    lines = ["the answer:", *findings(methods)]
    out: list[str] = []
    for i, line in enumerate(lines):  # one line each is sure, a second while there is room
        spare = MOST - 1 - len(out) - (len(lines) - i)
        out += _wrapped(line, 1 + min(spare, 1))
    return [*out, f"next: {following(methods, where)}"]


def findings(methods: Sequence[MethodRuns]) -> list[str]:
    """The sentences of the answer, "what (column): ...", not wrapped."""
    groups: dict[Any, list[MethodRuns]] = {}
    for method in methods:
        groups.setdefault(method.row["data"], []).append(method)
    each = max(1, OF_DATA // max(len(groups), 1))
    lines: list[str] = []
    for data, group in list(groups.items())[:OF_DATA]:
        head = f"{data}: " if len(groups) > 1 else ""
        lines += [head + line for line in _won(group)[:each]]
    if len(groups) > OF_DATA:
        lines[-1:] = [f"and {len(groups) - OF_DATA + 1} more data sets (data)"]
    found = alarms(methods)
    room = MOST - 2 - len(lines)
    if len(found) > room:
        found = [*found[: room - 1], f"alarm: and {len(found) - room + 1} more"]
    return [*lines, *found]


def _wrapped(line: str, most: int) -> list[str]:
    width = max(render.terminal_width(), 20)
    return textwrap.wrap(
        line,
        width,
        subsequent_indent="  ",
        max_lines=most,
        placeholder=" ...",
        break_on_hyphens=False,
    )


def _name(method: MethodRuns) -> str:
    return f"{method.row['backend']} {label(method.row)}"


def _few(names: Iterable[str]) -> str:
    listed = list(names)
    more = len(listed) - NAMED
    return ", ".join([*listed[:NAMED], *([f"{more} more"] if more > 0 else [])])


# --- who won


def _won(group: Sequence[MethodRuns]) -> list[str]:
    """The winner on one data set, who is tied, what it costs, who loses to no registration."""
    error = next((e for e in ERRORS if any(not is_empty(m.row.get(e[0])) for m in group)), None)
    won = None if error is None else _champion(group, error[0])
    if error is None or won is None:
        return ["winner: none, no row has an error (status)"]
    key, unit, _ = error
    timing = rotation.line(group, key)
    group = [m for m in group if m.row["selector"] != SHIFTED]
    of = len({_trajectories(m) for m in group})
    lines = [f"winner ({key}): {_name(won)}, {_spread(won, key, unit)}; {len(group)} rows"]
    lines[0] += f", {of} distinct" if of < len(group) else ""
    if len(group) > 1:
        lines.append(_tied(won, group, key))
    cost = won.row.get("ms_per_scan")
    if cost is not None and is_numeric_cell(cost):
        lines.append(_cost(won, group, float(cost)))
    nothing = [m.row[key] for m in group if m.row["backend"] == "none"]
    known = [float(v) for v in nothing if is_numeric_cell(v)]
    if known:
        rows = [m for m in group if m.row["backend"] != "none" and is_numeric_cell(m.row[key])]
        worse = [m for m in rows if m.row[key] > min(known)]
        words = _few(_name(m) for m in worse) or "no row"
        count = f"{len(worse)} of {len(rows)}: " if worse else ""
        bar = f"{three_digits(min(known))} {unit}"
        lines.append(f"worse than no registration ({key} > {bar}): {count}{words}")
    return [*lines[:2], *timing, *lines[2:]]


def _champion(group: Sequence[MethodRuns], key: str) -> MethodRuns | None:
    """The ``champion`` of methods. One alone takes no table: pandas is imported in half the time of
    a small run."""
    if len(group) == 1:
        return None if group[0].row["selector"] in NO_METHODS else group[0]
    table = table_of(group)
    best = champion(table, key)
    return None if best is None else group[table.index.get_loc(best.name)]


def _spread(method: MethodRuns, key: str, unit: str) -> str:
    row = method.row
    words = f"{three_digits(float(row[key]))} {unit}"
    if is_numeric_cell(row.get(f"{key}_q1")):
        q1, q3, worst = (three_digits(row[f"{key}_{end}"]) for end in ("q1", "q3", "worst"))
        return f"{words} [{q1} - {q3}], worst {worst}, {row['replicates']:.0f} replicates"
    runs = [run.metrics[key] for run in method.runs if is_numeric_cell(run.metrics.get(key))]
    if len(runs) < 2:
        return f"{words} (one run)"
    return f"{words} [{three_digits(min(runs))} to {three_digits(max(runs))}, {len(runs)} runs]"


def _tied(won: MethodRuns, group: Sequence[MethodRuns], key: str) -> str:
    """Those that the winner cannot be called better than, after Holm over all of them."""
    others = [m for m in group if m is not won and is_numeric_cell(m.row[key])]
    others = [m for m in others if m.row["selector"] not in NO_METHODS]
    pairs = better.beside_best(won, group, key)
    if all(one.unit == better.RUNS for _, one in pairs):
        near = [m for m in others if m.row[key] <= 1.05 * won.row[key]]
        return f"within 5% of it ({key}): {_few(map(_name, near)) or 'none'}; of runs, not proven"
    # rows that do not register have a line of their own, and no replicates that differ
    asked = [(m, one) for m, one in pairs if m.row["backend"] != "none"]
    tied = [m for m, one in asked if one.holds != "better"]
    words = _few(map(_name, tied)) or "none: it is better than every row that registers"
    count = f"{len(tied)} of {len(asked)}: " if tied else ""
    few = better.too_few([one for _, one in asked])
    by = f"p_holm, ratio of {key}" + (f"; {few}" if tied and few else "")
    return f"not told apart from it ({by}): {count}{words}"


def _cost(won: MethodRuns, group: Sequence[MethodRuns], cost: float) -> str:
    words = f"cost (ms_per_scan): {three_digits(cost)} ms"
    prices = {id(m): m.row.get("ms_per_scan") for m in group}
    priced = [m for m in group if is_numeric_cell(prices[id(m)])]
    least = min(priced, key=lambda m: prices[id(m)] or 0.0)
    if least is won:
        return f"{words}, the least of all" if len(group) > 1 else words
    of_least = three_digits(float(least.row["ms_per_scan"] or 0))
    return f"{words}; the least: {_name(least)}, {of_least} ms"


# --- alarms


def alarms(methods: Sequence[MethodRuns]) -> list[str]:
    """What to know before any of the numbers is believed, the gravest first."""
    runs = [run for method in methods for run in method.runs]
    failed = [run for run in runs if not run.done]
    lines = []
    if failed:
        why = failed[0].record.get("reason") or failed[0].record.get("status")
        lines.append(f"alarm (status): {len(failed)} of {len(runs)} runs failed: {why}")
    dead = [m for m in methods if any(is_dead(run) for run in m.runs)]
    if dead:
        shares = [f"{_name(m)} {min(map(_coverage, m.runs)):.0%}" for m in dead]
        lines.append(f"alarm (coverage): DEAD, under half registered: {_few(shares)}")
    by_words: dict[str, list[str]] = {}
    for method in methods:
        if method.row["backend"] != "none" and (words := idle_threshold(method.row)):
            by_words.setdefault(words, []).append(_name(method))
    lines += [f"alarm (decided): {words}: {_few(names)}" for words, names in by_words.items()]
    no_controls = [_name(m) for m in methods if rotation.is_previous(m.row)]
    if no_controls:
        what = "picks the scan before every time, no control"
        lines.append(f"alarm (mean_gap): {what}: {_few(no_controls)}")
    lines += [f"alarm (trajectory_sha256): {line}" for line in equals(methods)]
    cautions = dict.fromkeys(
        line.removeprefix("data: ") for run in runs for line in run.record.get("readings") or []
    )
    data = [line for line in cautions if line.startswith("caution")]
    return [*lines, *(f"alarm (data): {line}" for line in data)]


def is_dead(run: Run) -> bool:
    """Whether a run that does register has registered under half of its scans."""
    return run.done and run.choices.get("backend") != "none" and _coverage(run) < HALF


def _coverage(run: Run) -> float:
    share = run.metrics.get("coverage")
    return float(share or 0.0) if is_numeric_cell(share) else 1.0


def dead_words(run: Run) -> str:
    """What is loudly said of a dead run; "" of any other."""
    if not is_dead(run):
        return ""
    why = run.record.get("why_unregistered")
    words = f"DEAD RUN: only {_coverage(run):.0%} of its scans were registered"
    return f"{words}, most others: {why}" if why else words


def idle_threshold(row: dict[str, Any]) -> str:
    """In words a threshold that did the same for every scan; "" for one that acted."""
    decided = row.get("decided")
    if decided is None or not is_numeric_cell(decided) or 0 < decided < 1:
        return ""
    if decided == 1:
        return "the threshold decided every scan"
    always = {
        "oldest": "passed always (the same as oldest)",
        "none": "passed never (the fallback alone)",
        "undefined": "had no defined score",
    }
    what = next((w for pick, w in always.items() if row.get(f"pick_{pick}") == 1), "never decided")
    return f"the threshold {what}"


def equals(methods: Sequence[MethodRuns]) -> list[str]:
    """Methods that register and whose trajectories are equal to the bit, run for run: a line for
    each thing that this says."""
    groups: dict[Any, list[MethodRuns]] = {}
    for method in methods:
        is_other = method.row["backend"] != "none" and not rotation.is_previous(method.row)
        if is_other and (known := _trajectories(method)):
            loops = method.runs[0].choices.get("loops")  # closed afterwards: not of this path
            groups.setdefault((method.row["data"], loops, known), []).append(method)
    lines: dict[str, list[str]] = {}
    for group in groups.values():
        if len(group) > 1:
            bare = {(m.row["backend"], m.row["selector"]) for m in group}
            what = "settings that never bind: " if len(bare) == 1 else ""
            few = [*map(_name, group[:NAMED])]
            few += [f"{len(group) - NAMED} more"] if len(group) > NAMED else []
            lines.setdefault(_why_equal(group) + what, []).append(" = ".join(few))
    return [f"{what}{'; '.join(chains)} bit for bit" for what, chains in lines.items()]


def _why_equal(group: Sequence[MethodRuns]) -> str:
    """What it says of a threshold that its rows are those of a control."""
    selectors = {m.row["selector"] for m in group}
    if not selectors & set(rotation.RBTM):
        return ""
    if "oldest" in selectors:
        return "the threshold never decided: "
    return "the threshold never reached back: " if "previous" in selectors else ""


def _trajectories(method: MethodRuns) -> tuple[Any, ...]:
    return tuple(sorted((draw_of(run), trajectory_of(run)) for run in method.runs if run.done))


# --- what next


def following(methods: Sequence[MethodRuns], where: str) -> str:
    """The command that the numbers call for."""
    runs = [run for method in methods for run in method.runs]
    ill = next((run for run in runs if not run.done or is_dead(run)), None)
    if ill is not None:
        return f"rbtm-bench show {shlex.quote(str(ill.path))}"
    typed = shlex.split(str(runs[0].record.get("command") or ""))
    words = [w for w in typed[2:] if not w.startswith(("out=", "--resume", "overwrite="))]
    kind = typed[1] if len(typed) > 1 else ""
    if kind == "run" and any(w.startswith("+experiment") for w in words):  # it names the selector
        return shlex.join(["rbtm-bench", "compare", *words, "replicates=10"])
    if kind == "run":
        words = [w for w in words if not w.startswith("selector=")]
        own = runs[0].choices.get("selector")
        selectors = dict.fromkeys(["previous", "oldest", *([own] if own else [])])
        return shlex.join(["rbtm-bench", "compare", *words, f"selector={','.join(selectors)}"])
    idle = any(idle_threshold(m.row) for m in methods if m.row["backend"] != "none")
    if idle and kind == "compare":
        words = [w for w in words if not w.startswith("selector.threshold=")]
        return shlex.join(["rbtm-bench", kind, *words, "selector.threshold=0.6,0.7,0.8,0.9,0.95"])
    if kind == "compare" and not any("replicate" in w for w in words):
        return shlex.join(["rbtm-bench", kind, *words, "replicates=10"])
    return f"rbtm-bench table {where} --intervals"
