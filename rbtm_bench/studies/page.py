"""A study's page: tables from its runs, in a Jinja template."""

from __future__ import annotations

import math
import shlex
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd

from rbtm_bench.core import escape
from rbtm_bench.core.columns import KNOWN
from rbtm_bench.core.files import make_folder, write_text
from rbtm_bench.engine import sweep_folder
from rbtm_bench.report.better import Comparison
from rbtm_bench.report.render import render, three_digits
from rbtm_bench.studies import figures
from rbtm_bench.studies.outcome import Outcome
from rbtm_bench.studies.plan import Method
from rbtm_bench.studies.study_file import Study

PAGE = "README.md"
TABLES = ("table.csv", "ratios.csv")
WORDS = {
    "deciding": "Left: the ratio of an RBTM's error to that of its own gaps at other times, with "
    "95 % intervals. Right: error against mean gap, every way with all tries of its own key, the "
    "one that other data chose large.",
    "axis": "The error of every way over the axis, with its one setting or the one that was "
    "chosen.",
    "map": "Where {ours} has less error (blue) or more (red) than {other}; grey: undecided.",
}


def write(outcome: Outcome, command: Sequence[str], seconds: float, out: Path) -> None:
    """Write the page, its tables as CSV, and its figures."""
    study = outcome.plan.study
    drawn = figures.draw(outcome, out)
    table, ratios = errors(outcome), all_ratios(outcome)
    for name, rows in zip(TABLES, (table, ratios), strict=True):
        write_text(out / name, escape.csv_table(rows).to_csv(index=False, float_format="%.5g"))
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rbtm_bench.studies"),
        undefined=jinja2.StrictUndefined,
        autoescape=False,
        keep_trailing_newline=True,
    )
    text = environment.get_template("study.md.j2").render(
        study=study,
        command=shlex.join(command),
        runs=len(set(outcome.plan.names.values())),
        failed=len(outcome.failed),
        minutes=three_digits(seconds / 60),
        versions=", ".join(f"{k} {v}" for k, v in sweep_folder.versions().items() if v),
        column=KNOWN[study.metric],
        tables=_tables(outcome, table),
        ratios={ours: _md(_ratio_table(outcome, ours)) for ours in study.ours},
        figures={file.name: _caption(file.stem) for file in drawn},
    )
    write_text(out / PAGE, text.rstrip() + "\n")


def leave(out: Path, folder: Path, stem: str) -> None:
    """Copy the page of a study, its tables and pictures into a folder, named by ``stem``."""
    make_folder(folder)
    text = (out / PAGE).read_text(encoding="utf-8")
    for file in sorted(out.glob("*.png")):
        if f"({file.name})" in text:
            text = text.replace(f"({file.name})", f"({stem}_{file.name})")
            shutil.copyfile(file, folder / f"{stem}_{file.name}")
    write_text(folder / f"{stem}.md", text)
    shutil.copyfile(out / TABLES[0], folder / f"{stem}.csv")


def errors(outcome: Outcome) -> pd.DataFrame:
    """A row a method: its choice, its error with quartiles, its mean gap."""
    rows = []
    for method, chosen in outcome.chosen.items():
        known = pd.Series(outcome.values(method, chosen.k), dtype=float)
        q1, median, q3 = (float(known.quantile(q)) for q in (0.25, 0.5, 0.75))
        rows.append(
            {
                **method._asdict(), "tries": chosen.tried, "chosen": chosen.k + 1,
                "setting": _setting(outcome.plan.study, method, chosen.k), "median": median,
                "q1": q1, "q3": q3, "n": len(known), "regret": chosen.regret,
                "mean_gap": outcome.mean_gap(method, chosen.k),
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def all_ratios(outcome: Outcome) -> pd.DataFrame:
    """A row a comparison: the ratio of medians with its interval, p after Holm, what holds."""
    rows = []
    for ours in outcome.plan.study.ours:
        for (method, other), one in outcome.comparisons(ours).items():
            over = one.ratio
            low, high = (over.low, over.high) if over else (None, None)
            row: dict[str, Any] = {**method._asdict(), "other": other}
            row |= {"ratio": one.ours / one.theirs, "low": low, "high": high, "n": one.n}
            rows.append({**row, "p_holm": one.p_holm, "equal": one.equal, "holds": one.holds})
    return pd.DataFrame(rows)


def _tables(outcome: Outcome, table: pd.DataFrame) -> dict[str, str]:
    study = outcome.plan.study
    rows = [(name, d.status, f"`{' '.join(d.words)}`") for name, d in study.data.items()]
    tests = [name for name, way in study.ways.items() if way.selector == "shifted_gap"]
    choices = table[(table["tries"] > 1) & ~table["way"].isin(tests)]
    return {
        "data": _md(pd.DataFrame(rows, columns=["data", "status", "overrides"])),
        "ways": _md(_ways(outcome)),
        "errors": _md(_wide(table, _error, _mark(study))),
        "regret": _md(_wide(choices, _regret, "tuned")) if len(choices) else "",
        "pooled": _md(_pooled(outcome)),
    }


def _wide(table: pd.DataFrame, cell: Callable[[Any], str], mark: str) -> pd.DataFrame:
    """Rows data and backend, columns ways, which have all the same mark."""
    order = list(dict.fromkeys(table["way"]))
    words = table.assign(cell=[cell(row) for _, row in table.iterrows()])
    wide = words.pivot_table(
        index=["data", "backend"], columns="way", values="cell", aggfunc="first", sort=False
    )[order]
    return wide.rename(columns={way: f"{way} ({mark})" for way in order}).reset_index()


def _mark(study: Study) -> str:
    """What the columns of errors are, by all of the study's data."""
    kinds = {data.status for data in study.data.values()}
    return kinds.pop() if len(kinds) == 1 else "seen or held out, by row"


def _error(row: Any) -> str:
    if math.isnan(row["median"]):
        return "failed"
    if row["n"] < 3:
        return three_digits(row["median"])
    ends = f"{three_digits(row['q1'])} - {three_digits(row['q3'])}"
    return f"{three_digits(row['median'])} [{ends}]"


def _regret(row: Any) -> str:
    lost = row["regret"]
    return row["setting"] if math.isnan(lost) else f"{row['setting']}; x{lost:.3g}"


def _setting(study: Study, method: Method, k: int) -> str:
    """The try in words: "0.5, 0.8" in the order of the keys."""
    values = study.tries(study.ways[method.way])[k].values()
    return ", ".join(f"{v:g}" if isinstance(v, int | float) else str(v) for v in values)


def _ways(outcome: Outcome) -> pd.DataFrame:
    study, rows = outcome.plan.study, []
    for name, way in study.ways.items():
        gaps = [
            gap
            for method in outcome.plan.methods(name)
            for k in range(outcome.tries(method))
            if (gap := outcome.mean_gap(method, k)) == gap
        ]
        knobs = {key.rpartition(".")[2]: values for key, values in study.knobs(way).items()}
        lists = [f"{key} {', '.join(map(str, values))}" for key, values in knobs.items()]
        row = {"way": name, "what": f"`{' '.join(way.words)}`", "tried": "; ".join(lists)}
        if way.like:
            row |= {"what": f"{way.selector} like {way.like}", "tried": "those of that way"}
        spans = f"{min(gaps):.3g} - {max(gaps):.3g}" if gaps else ""
        tries = len(study.tries(way))
        rows.append({**row, "tries": tries, "mean gaps (seen)": spans, "note": way.note})
    return pd.DataFrame(rows)


def _ratio_table(outcome: Outcome, ours: str) -> pd.DataFrame:
    comparisons = outcome.comparisons(ours)
    rows = [
        {**method._asdict(), "way": other, "of": one}
        for (method, other), one in comparisons.items()
    ]
    mark = _mark(outcome.plan.study)
    return (
        _wide(pd.DataFrame(rows), lambda row: _ratio(row["of"]), mark) if rows else pd.DataFrame()
    )


def _ratio(one: Comparison) -> str:
    if one.equal:
        return "1 ="
    words = three_digits(one.ours / one.theirs)
    if one.ratio and one.ratio.low is not None and one.ratio.high is not None:
        words += f" [{three_digits(one.ratio.low)}, {three_digits(one.ratio.high)}]"
    return f"{words} **{one.holds}**" if one.holds else words


def _pooled(outcome: Outcome) -> pd.DataFrame:
    study, rows = outcome.plan.study, []
    for ours in study.ours:
        for other in outcome.others(ours):
            one = outcome.pooled(ours, other)
            if one is not None:
                mark = _mark(study)
                row: dict[str, Any] = {"way": ours, "against": other}
                row[f"ratio ({mark})"] = three_digits(one.ratio)
                row[f"over draws ({mark})"] = _ends(one.draws)
                row[f"over data sets ({mark})"] = f"{_ends(one.places)} ({one.n_places})"
                row["cells that are 1 by construction"] = f"{one.by_construction} of {one.cells}"
                rows.append(row)
    return pd.DataFrame(rows)


def _ends(ends: tuple[float, ...] | None) -> str:
    return f"[{', '.join(map(three_digits, ends))}]" if ends else "none"


def _caption(stem: str) -> str:
    kind, _, rest = stem.partition("_")
    ours, _, other = rest.rpartition("_")
    return WORDS[kind].format(ours=ours, other=other)


def _md(table: pd.DataFrame) -> str:
    return render(table, "md") if len(table) else "(nothing)"
