"""Run folders written by hand for tables with intervals and tests, and how to read those."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from rbtm_bench.cli.commands import main
from rbtm_bench.core.files import write_json, write_text
from rbtm_bench.metrics.relation_errors import RelationErrors

MM = "final_translation_error_mm"
MEAN = "relations_translation_mean_m"
LONG = "relations_long_translation_mean_m"


def make_run(
    path: Path,
    selector: str,
    metrics: dict[str, Any] | None,
    *,
    backend: str = "p2p",
    seed: int = 0,
    dataset: str = "corridor",
    data: dict[str, Any] | None = None,
    fingerprint: str | None = None,
    told: dict[str, Any] | None = None,
    guess: str = "",
    **settings: Any,
) -> Path:
    """A run's files; without metrics it failed. ``settings`` are the selector's, ``told`` what
    else run.json says."""
    path.mkdir(parents=True)
    config = {"seed": seed, "out": str(path), "dataset": {"seed": seed, **(data or {})}}
    config |= {"backend": {"radius": 0.3}, "selector": settings}
    write_text(path / "config.yaml", yaml.safe_dump(config))
    status = "failed" if metrics is None else "done"
    choices = {"dataset": dataset, "backend": backend, "selector": selector}
    choices |= {"guess": guess} if guess else {}
    record = {"status": status, "choices": choices, "seed": seed, "scans": 11}
    write_json(path / "run.json", {**record, "dataset_fingerprint": fingerprint, **(told or {})})
    if metrics is not None:
        write_json(path / "metrics.json", metrics)
    return path


def make_seeds(
    folder: Path, selector: str, errors: Sequence[float | None], name: str = "", **more: Any
) -> None:
    """A run for every seed 0, 1, ... with this final position error; None: it failed."""
    data = more.get("data") or {}
    for seed, error in enumerate(errors):
        where = folder / f"{name or selector}-{more.get('backend', 'p2p')}-{seed}"
        metrics = None
        if error is not None:
            metrics = {MM: float(error), "mean_gap": 1.0 + error, "localizability": 0.1 * seed}
        make_run(where, selector, metrics, seed=seed, fingerprint=f"{data} {seed}", **more)


def make_replicates(
    folder: Path,
    selector: str,
    errors: Sequence[float | None],
    *,
    name: str = "",
    prefix: str = "",
    same: Sequence[int] = (),
    unperturbed: float | None = None,
    **settings: Any,
) -> None:
    """A run on a log for every replicate 1, 2, ... with this final position error (None: it
    failed), and one on the log as it is. Those numbered in ``same`` have equal trajectories;
    ``prefix`` instead of the name makes trajectories those of another method."""
    name = name or selector
    numbered = [(0, unperturbed)] if unperturbed is not None else []
    for number, error in [*numbered, *enumerate(errors, start=1)]:
        of = {"number": number, "seed": 0, "of": "log"} if number else None
        path = "the same" if number in same else f"{number}"
        told = {"replicate": of, "trajectory_sha256": f"{prefix or name} {path}"}
        metrics = None if error is None else {MM: float(error)}
        where = folder / f"{name}-{number}"
        copy = f"log {number}" if number else "log"
        make_run(where, selector, metrics, fingerprint=copy, told=told, **settings)


def make_log(path: Path, selector: str, long: Sequence[float], **more: Any) -> Path:
    """A run on a log: a long relation with each error, in clusters of its own 100 s apart, and as
    many local ones of 0.5 m, in blocks of their own. A NaN has no estimated pose."""
    count = len(long)
    start = 100.0 * np.arange(count)
    errors = RelationErrors(
        np.concatenate([start, start]),
        np.concatenate([start + 1000.0, start + 1.0]),
        np.repeat([False, True], count),
        np.concatenate([np.asarray(long, np.float64), np.full(count, 0.5)]),
        np.full(2 * count, 2.0),
    )
    known = errors.translation_m[errors.used]
    metrics = {MEAN: float(known.mean()), LONG: float(np.nanmean(long)), MM: None}
    metrics |= {"relations_local_translation_mean_m": 0.5, "ms_per_scan": 3.0}
    more = {"dataset": "carmen", "data": {"path": "a.clf"}, "fingerprint": "log a"} | more
    make_run(path, selector, metrics, **more)
    errors.write(path / "relations.parquet")
    return path


def shown(capsys: Any, *words: str) -> tuple[str, str]:
    """Standard output and error of ``rbtm-bench table`` with these words."""
    assert main(["table", *words]) == 0
    told = capsys.readouterr()
    return told.out, told.err


def check_latex(text: str) -> list[list[str]]:
    """The cells of a booktabs table, if LaTeX would take it: one tabular, its rules in order, as
    many cells in every row as columns, nothing special unescaped, braces in pairs."""
    lines = text.splitlines()
    begun = re.fullmatch(r"\\begin\{tabular\}\{([lr]+)\}", lines[0])
    assert begun and lines[-1] == r"\end{tabular}"
    rules = [line for line in lines if line.startswith(r"\t") or "rule" in line]
    assert rules == [r"\toprule", r"\midrule", r"\bottomrule"]
    rows = [line for line in lines[1:-1] if line not in rules]
    assert all(row.endswith(r" \\") for row in rows)
    for row in rows:
        plain = re.sub(r"\\[&%$#_{}]|\\textasciitilde |\\textbackslash ", "", row[:-3])
        assert not re.search(r"[%$#_{}~^\\]", plain), row
        assert plain.count("&") == len(begun[1]) - 1, row
    return [[cell.strip() for cell in re.split(r"(?<!\\)&", row[:-3])] for row in rows]
