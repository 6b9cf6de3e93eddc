"""The subcommand that measures error against similarity: calibrate."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.engine.progress import bar

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from rbtm_bench.calibration.analysis import Measured
    from rbtm_bench.calibration.plan import CalibrationPlan
    from rbtm_bench.calibration.running import Asked
    from rbtm_bench.calibration.sampling import Sample
    from rbtm_bench.calibration.tables import Findings
    from rbtm_bench.engine.crew import Supervisor
    from rbtm_bench.runs.grid import Point

HELP = """\
Error against similarity: which threshold and window should RBTM have on this data?

Pairs of scans are registered and compared with the truth: does a high similarity mean a small
error, more than a small gap does anyway, and from which similarity on?

examples
  rbtm-bench calibrate                                              the embedded corridor
  rbtm-bench calibrate backend=open3d_p2p,plicp similarity=curvature,curvature_circular
  rbtm-bench calibrate dataset=carmen dataset.path=aces.clf.gz dataset.relations=aces.relations
  rbtm-bench calibrate dataset=carmen dataset.path=intel-corrected.log.gz --success 0.9
  rbtm-bench calibrate similarity.half_span_deg=3,5,8 seed=0,1,2 --within 0.01,0.5
  rbtm-bench calibrate --write mine/experiment/corridor.yaml
  rbtm-bench run --config-dir mine +experiment=corridor             ... and use it

Truth: true poses, else relations (short ones in a row are joined over larger gaps), else none:
then registrations forward, backward and over a scan between must agree, and every result says so.
The data are cut in two: the advice is chosen on one part and what it does is measured on the other.

The folder (--out, or out=DIR) holds report.txt (what is printed), summary.csv and summary.md (a row
a backend and similarity), roc.csv, curves.csv (success and errors over similarity), pairs.parquet,
scores.parquet, calibration.json and figures. docs/calibration.md defines everything."""


def calibrate(words: list[str]) -> int:
    """``rbtm-bench calibrate``."""
    options, overrides = _parse(words)
    from rbtm_bench.calibration import running
    from rbtm_bench.engine import drive
    from rbtm_bench.runs.claim import refuse_existing
    from rbtm_bench.runs.grid import make_points

    plan = plan_of(options)
    jobs = options.jobs if options.jobs is not None else drive.default_jobs()
    if jobs < 1:
        raise ConfigError(f"--jobs {jobs}: expected at least 1")
    write = _place_to_write(options.write)
    points, notes = make_points(overrides, tuple(map(Path, options.config_dir)))
    asked = running.asked_of(points)
    config = points[0].settings.config
    out = _folder(options.out, config)
    refuse_existing(out, bool(config["overwrite"]))
    for note in notes:
        print(note, file=sys.stderr)
    with drive.make_crew(jobs) as crew:
        _measure(points, asked, plan, crew, out)
    if write is not None:
        _write_experiment(out, asked, points, write)
    return 0


def _measure(
    points: Sequence[Point],
    asked: Asked,
    plan: CalibrationPlan,
    crew: Sequence[Supervisor],
    out: Path,
) -> None:
    from rbtm_bench.calibration import report, running, tables
    from rbtm_bench.core.files import make_folder, write_text
    from rbtm_bench.engine import one_run

    pin = bool(points[0].settings.config["pin"])
    crew[0].call(one_run.check_data, [_without_guess(point) for point in points], pin=pin)
    with bar("calibrate") as progress:
        measured, samples = running.measure(asked, plan, crew, pin, progress.update_to)
        progress.update_to(0, None, "resampling")
        # in a pinned child: sums on one core have the same last bits everywhere
        findings = crew[0].call(tables.analyse, measured, plan.success, pin=pin)
        progress.update_to(0, None, "drawing")
        make_folder(out)
        names = _data_names(points, asked)
        text = report.text(measured, samples, findings, plan, names)
        tables.write(measured, findings, out)
        write_text(out / "report.txt", text + "\n")
        _write_record(points, plan, samples, findings, out)
        drawn = _figures(measured, findings, plan, samples, names)
        _save_figures(drawn, out)
    files = "report.txt, summary.md, roc.csv, curves.csv, pairs.parquet"
    print(text)
    print(f"\n{out}: {files}, {len(drawn)} figures")


def _without_guess(point: Point) -> Point:
    """The point with a guess that every data set can give: a calibration has guesses of its own."""
    from dataclasses import replace

    guess = {"_target_": "rbtm_bench.guess.identity.Identity"}
    settings = replace(point.settings, config={**point.settings.config, "guess": guess})
    return replace(point, settings=settings)


def _figures(
    measured: Measured,
    findings: Findings,
    plan: CalibrationPlan,
    samples: Sequence[Sample],
    names: Sequence[str],
) -> list[tuple[str, Figure]]:
    """The figures, each with the stem of its file's name."""
    from rbtm_bench.calibration import tables
    from rbtm_bench.plots import calibration, style

    stand_in = samples[0].truth is None
    with style.paper():
        return calibration.figures(
            tables.pair_rows(measured),
            measured.scores,
            findings.curves,
            findings.roc,
            plan.within,
            stand_in,
            ", ".join(names),
        )


def _save_figures(drawn: Sequence[tuple[str, Figure]], out: Path) -> None:
    from rbtm_bench.plots import style

    with style.paper():
        for stem, figure in drawn:
            style.save(figure, out, re.sub(r"[^\w.=+-]+", "_", stem))


def _data_names(points: Sequence[Point], asked: Asked) -> list[str]:
    """The data sets as one would name them: a log by its file's name."""
    names = []
    for label, node in asked.data.items():
        path = node.get("path")
        first = label.split(" ")[0]
        names.append(label.replace(first, f"{first} {Path(str(path)).name}", 1) if path else label)
    return names


def _write_record(
    points: Sequence[Point],
    plan: CalibrationPlan,
    samples: Sequence[Sample],
    findings: Findings,
    out: Path,
) -> None:
    """``calibration.json``: what was asked, how pairs came about, and where it was computed."""
    from dataclasses import asdict

    from rbtm_bench.core.files import write_json
    from rbtm_bench.runs import provenance

    record = provenance.of_run(points[0].settings, None, None)
    for key in ("status", "reason", "scans", "skipped_records", "dataset_fingerprint", "core"):
        record.pop(key, None)
    record["finished"] = provenance.now()
    record["plan"] = asdict(plan)
    record["samples"] = [{**sample.conditions, **sample.counts} for sample in samples]
    record["points"] = [point.settings.config for point in points]
    record["best"] = findings.best
    write_json(out / "calibration.json", record)


def _place_to_write(name: str | None) -> Path | None:
    """Where the YAML goes: in a folder called experiment, where Hydra looks for it."""
    if name is None:
        return None
    path = Path(name)
    if path.suffix != ".yaml" or not re.fullmatch(r"[\w.+-]+", path.stem):
        raise ConfigError(f"--write {name}: expected a name of letters and digits, ending in .yaml")
    if path.absolute().parent.name != "experiment":
        path = path.parent / "experiment" / path.name
    if path.exists():
        raise ConfigError(f"--write {path}: exists already; choose another name")
    return path


def _write_experiment(out: Path, asked: Asked, points: Sequence[Point], path: Path) -> None:
    """Write the best advice as an experiment and say how to use it."""
    from rbtm_bench.calibration import experiment_file
    from rbtm_bench.core.files import make_folder, write_text

    content = experiment_file.content(out, asked, points)
    if content is None:
        print(f"{path}: not written, no advice for these data", file=sys.stderr)
        return
    make_folder(path.parent)
    write_text(path, content)
    folder = path.parent.parent
    print(f"{path}: use it as   rbtm-bench run --config-dir {folder} +experiment={path.stem} ...")


def _folder(option: str | None, config: dict[str, Any]) -> Path:
    from rbtm_bench.runs.claim import default_folder

    if option and config["out"]:
        raise ConfigError("--out and out=: give one of them")
    return Path(option or config["out"] or default_folder("calibrate"))


def plan_of(options: argparse.Namespace) -> CalibrationPlan:
    """The checked options."""
    from rbtm_bench.calibration.plan import CalibrationPlan

    gaps = None if options.gaps is None else tuple(_numbers("--gaps", options.gaps, int))
    return CalibrationPlan(
        gaps=gaps,
        pairs=options.pairs,
        revisits=options.revisits,
        truth=options.truth,
        chain=options.chain,
        guess=options.guess,
        disturb=_two("--disturb", options.disturb),
        revisit_error=_two("--revisit-error", options.revisit_error) or (0.0, 0.0),
        within=_two("--within", options.within) or (0.0, 0.0),
        success=options.success,
        split=options.split,
        block_s=options.block,
        seed=options.seed,
    )


def _numbers(option: str, text: str, kind: type) -> list[Any]:
    try:
        return [kind(word) for word in text.split(",")]
    except ValueError:
        what = "whole numbers" if kind is int else "numbers"
        raise ConfigError(f"{option} {text}: expected {what} with commas between") from None


def _two(option: str, text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    numbers = _numbers(option, text, float)
    if len(numbers) != 2:
        raise ConfigError(f"{option} {text}: expected two numbers, metres and degrees: 0.1,2")
    return numbers[0], numbers[1]


def _parse(words: list[str]) -> tuple[argparse.Namespace, list[str]]:
    from rbtm_bench.calibration.guesses import GUESSES
    from rbtm_bench.calibration.plan import GAPS, SPLITS, TRUTHS

    parser = argparse.ArgumentParser(
        prog="rbtm-bench calibrate",
        description=HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="rbtm-bench calibrate [key=value ...] [options]",
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--success", type=float, default=0.95, metavar="SHARE", help="wanted rate (default 0.95)")
    add("--within", default="0.1,2", metavar="M,DEG",
        help="success: at most so far from the truth (default 0.1,2; the errors of corrected poses "
        "and relations are about 0.03 m and 0.3 deg)")  # fmt: skip
    add("--gaps", metavar="A,B,...",
        help=f"scans from model to new scan (default {','.join(map(str, GAPS))}, as far as scans "
        "see each other)")  # fmt: skip
    add("--pairs", type=int, default=200, metavar="N", help="pairs a gap, at most (default 200)")
    add("--revisits", type=int, default=200, metavar="N",
        help="pairs over revisits, at most (default 200; 0: none)")  # fmt: skip
    add("--revisit-error", default="0.2,5", metavar="M,DEG",
        help="error of the guess over revisits (default 0.2,5)")  # fmt: skip
    add("--truth", choices=TRUTHS, default="auto", help="where truth comes from (default auto)")
    add("--chain", type=int, default=4, metavar="N",
        help="relations joined in a row, at most (default 4; 1: each by itself)")  # fmt: skip
    add("--guess", choices=GUESSES, default="auto",
        help="initial guess (auto: odometry, else constant_velocity, else identity)")  # fmt: skip
    add("--disturb", metavar="M,DEG",
        help="error added to every guess (default none; without truth 0.2,5)")  # fmt: skip
    add("--split", choices=SPLITS, default="time",
        help="calibration and reported part: first and second half, or blocks in turn")  # fmt: skip
    add("--block", type=float, default=60.0, metavar="S", help="length of such blocks (default 60)")
    add("--seed", type=int, default=0, help="of revisits and disturbances (default 0)")
    add("--write", metavar="FILE.yaml",
        help="write the best advice as an experiment, in a folder called experiment")  # fmt: skip
    add("--out", metavar="DIR", help="folder of the results (default results/calibrate/TIME)")
    add("--jobs", "-j", type=int, default=None, help="processes (default: all cores)")
    add("--config-dir", "-cd", action="append", default=[], metavar="DIR", help="more plug-ins")
    options, rest = parser.parse_known_args(words)
    return options, overrides_of("calibrate", rest)


def overrides_of(command: str, rest: list[str]) -> list[str]:
    """The words left over by our options, which must be overrides."""
    for word in rest:
        if word.startswith("-"):
            raise ConfigError(f"{word}: no such option; see rbtm-bench {command} --help")
        if word.find("=") < 1 and not word.startswith("~"):
            raise ConfigError(f"{word}: expected key=value")
    from rbtm_bench.runs.words import as_typed

    return as_typed(rest)
