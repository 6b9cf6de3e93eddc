"""The one screen at the end of a run or a comparison, and the tables that go with it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rbtm_bench import results, tables
from rbtm_bench.files import write_text

RUN_LINES = (
    ("final_translation_error_mm", "final position error", "mm"),
    ("final_rotation_error_deg", "final rotation error", "deg"),
    ("ape_rmse_m", "APE RMSE, first pose aligned", "m"),
    ("relations_translation_mean_m", "mean relation error", "m"),
    ("relations_translation_std_m", "  standard deviation", "m"),
    ("relations_rotation_mean_deg", "mean relation rotation error", "deg"),
    ("relations_used", "relations used", ""),
    ("coverage", "share of scans registered", ""),
    ("mean_gap", "mean gap to the model scan", "scans"),
    ("rejected", "registrations rejected", ""),
    ("fallbacks", "fallbacks", ""),
    ("undefined_scores", "undefined similarities", ""),
    ("ms_per_scan", "time a scan", "ms"),
)


def of_run(out: Path) -> str:
    """A run's main numbers and where its files are."""
    run = results.read_run(out)
    row = results.row(run)
    head = f"{row['dataset']}, {row['backend']}, {row['selector']}"
    lines = [f"{head}: {row['scans']} scans in {row['seconds']:.1f} s"]
    for key, name, unit in RUN_LINES:
        value = row.get(key)
        if value is not None:
            number = f"{value:.4g}" if isinstance(value, float) else str(value)
            lines.append(f"  {name:<30} {number:>10} {unit}".rstrip())
    if run.record.get("skipped_records"):
        lines.append(f"  {run.record['skipped_records']} malformed records were skipped")
    lines.append(f"results in {out}   (figures: rbtm-bench plot {out})")
    return "\n".join(lines)


def of_runs(out: Path, folders: Sequence[Path]) -> str:
    """The table of a comparison or sweep, the verdict in words, and where the files are.

    Writes ``table.csv`` (a row a run) and ``summary.csv`` (a row a method).
    """
    runs = results.find_runs(folders)
    every, methods = results.frame(runs), results.over_seeds(runs)
    write_text(out / "table.csv", tables.render(every, "csv") + "\n")
    write_text(out / "summary.csv", tables.render(methods, "csv") + "\n")
    seeds = int(methods["seeds"].max())
    screen, same = tables.screen(methods)
    lines = [tables.render(screen, "text")]
    lines += [f"the same in every row: {same}"] if same else []
    if seeds > 1:
        lines.append(f"medians over the runs of a method that differ only in their seed ({seeds})")
    lines += tables.verdict(methods)
    lines.append(f"a row a run: {out / 'table.csv'}; a row a method: {out / 'summary.csv'}")
    lines.append(f"figures: rbtm-bench plot {out}")
    return "\n".join(lines)


def failures(folders: Sequence[Path]) -> list[str]:
    """A line for every run that did not end well."""
    runs = results.find_runs(folders)
    return [f"{r.path.name}: {r.record.get('reason')}" for r in runs if not r.done]
