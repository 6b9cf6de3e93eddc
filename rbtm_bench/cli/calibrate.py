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
    from rbtm_bench.calibration.trial import Verdict
    from rbtm_bench.engine.crew import Supervisor
    from rbtm_bench.runs.grid import Point

HELP = """\
Which model scan on this data: RBTM (threshold, window), a keyframe every so many m, a fixed gap?

Pairs of scans are registered and compared with the truth: what would a chain of them drift, does a
high similarity mean a small error, more than a small gap does anyway, and from which similarity on?
The settings that pairs predict to drift least are then run, with replicates, on the first half of
the data; the best one, beside previous and the default keyframe and rbtm, on the second half.

examples
  rbtm-bench calibrate                                              the embedded corridor
  rbtm-bench calibrate backend=open3d_p2p,plicp similarity=curvature,curvature_circular
  rbtm-bench calibrate dataset=carmen dataset.path=aces.clf.gz dataset.relations=aces.relations
  rbtm-bench calibrate dataset=carmen dataset.path=intel-corrected.log.gz perturb.end_scan=500
  rbtm-bench calibrate similarity.half_span_deg=3,5,8 seed=0,1,2 --within 0.01,0.5 --replicates 0
  rbtm-bench calibrate --write mine/experiment/corridor.yaml
  rbtm-bench run --config-dir mine +experiment=corridor             ... and use it

Truth: true poses, else relations (short ones in a row are joined over larger gaps); local relations
that are the wheels' own motion choose nothing. --replicates 0 runs nothing and advises nothing.

The folder (--out, or out=DIR) holds report.txt (what is printed), trials.csv (a row a setting that
was run), gaps.csv, summary.csv and summary.md (a row a backend and similarity), roc.csv, curves.csv
(success and errors over similarity), pairs.parquet, scores.parquet, calibration.json, runs/ and
figures. docs/calibration.md defines everything."""


def calibrate(words: list[str]) -> int:
    """``rbtm-bench calibrate``."""
    options, overrides = _parse(words)
    from rbtm_bench.calibration import running
    from rbtm_bench.engine import drive
    from rbtm_bench.runs.claim import refuse_existing
    from rbtm_bench.runs.grid import make_points

    plan = plan_of(options)
    refuse_own(overrides)
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
        verdicts = _measure(points, asked, plan, crew, out, tuple(map(Path, options.config_dir)))
    if write is not None:
        _write_experiment(verdicts, write)
    return 0


def _measure(
    points: Sequence[Point],
    asked: Asked,
    plan: CalibrationPlan,
    crew: Sequence[Supervisor],
    out: Path,
    extra_dirs: tuple[Path, ...],
) -> dict[str, Verdict]:
    from rbtm_bench.calibration import report, running, tables
    from rbtm_bench.core.files import make_folder, write_text
    from rbtm_bench.engine import one_run

    pin = bool(points[0].settings.config["pin"])
    crew[0].call(one_run.check_data, [_without_guess(point) for point in points], pin=pin)
    with bar("calibrate") as progress:
        advance = progress.update_to
        measured, samples = running.measure(asked, plan, crew, pin, advance)
        advance(0, None, "resampling")
        # in a pinned child: sums on one core have the same last bits everywhere
        findings = crew[0].call(tables.analyse, measured, samples, pin=pin)
        make_folder(out)
        verdicts = running.run_trials(
            points, asked, plan, samples, findings.candidates, out, extra_dirs, crew, advance
        )
        advance(0, None, "drawing")
        names = _data_names(asked)
        text = report.text(measured, samples, findings, verdicts, plan, names)
        tables.write(measured, findings, verdicts, out)
        write_text(out / "report.txt", text + "\n")
        _write_record(points, plan, samples, verdicts, out)
        drawn = _figures(measured, findings, plan, names)
        _save_figures(drawn, out)
    files = "report.txt, trials.csv, summary.md, roc.csv, curves.csv, pairs.parquet"
    print(text)
    print(f"\n{out}: {files}, {len(drawn)} figures")
    return verdicts


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
    names: Sequence[str],
) -> list[tuple[str, Figure]]:
    """The figures, each with the stem of its file's name."""
    from rbtm_bench.calibration import tables
    from rbtm_bench.plots import calibration, style

    with style.paper():
        return calibration.figures(
            tables.pair_rows(measured),
            measured.scores,
            findings.curves,
            findings.roc,
            plan.within,
            ", ".join(names),
        )


def _save_figures(drawn: Sequence[tuple[str, Figure]], out: Path) -> None:
    from rbtm_bench.plots import style

    with style.paper():
        for stem, figure in drawn:
            style.save(figure, out, re.sub(r"[^\w.=+-]+", "_", stem))


def _data_names(asked: Asked) -> list[str]:
    """The data sets as one would name them: a log by its file's name."""
    names = []
    for label, node in asked.data.items():
        path = node["dataset"].get("path")
        first = label.split(" ")[0]
        names.append(label.replace(first, f"{first} {Path(str(path)).name}", 1) if path else label)
    return names


def _write_record(
    points: Sequence[Point],
    plan: CalibrationPlan,
    samples: Sequence[Sample],
    verdicts: dict[str, Verdict],
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
    record["advice"] = {
        backend: {"setting": v.advice.name, "kept": v.kept, "instead": v.instead.name}
        for backend, v in verdicts.items()
    }
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


def _write_experiment(verdicts: dict[str, Verdict], path: Path) -> None:
    """Write the advice of the backend with the least error on the calibration part as an
    experiment and say how to use it."""
    from rbtm_bench.calibration import experiment_file
    from rbtm_bench.core.files import make_folder, write_text

    if not verdicts:
        print(f"{path}: not written, nothing was run", file=sys.stderr)
        return
    least = min(verdicts, key=lambda backend: min(t.median for t in verdicts[backend].tried))
    make_folder(path.parent)
    command = " ".join(["rbtm-bench", *sys.argv[1:]])
    write_text(path, experiment_file.content(least, verdicts[least], command))
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
        replicates=options.replicates,
        seed=options.seed,
    )


def refuse_own(overrides: Sequence[str]) -> None:
    """Refuse what a calibration asks for itself."""
    for word in overrides:
        key = word.lstrip("+").partition("=")[0]
        if key.partition(".")[0] == "selector" or key in ("replicates", "replicate"):
            what = "chooses the selector" if key[0] == "s" else "has --replicates N"
            raise ConfigError(f"{word}: a calibration {what} itself")


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
    from rbtm_bench.calibration.plan import GAPS, TRUTHS

    parser = argparse.ArgumentParser(
        prog="rbtm-bench calibrate",
        description=HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="rbtm-bench calibrate [key=value ...] [options]",
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--replicates", type=int, default=10, metavar="N",
        help="perturbed copies that settings are run on (default 10; 0: run nothing)")  # fmt: skip
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
        help="error added to every guess (default none)")  # fmt: skip
    add("--seed", type=int, default=0, help="of revisits and disturbances (default 0)")
    add("--write", metavar="FILE.yaml",
        help="write the advice as an experiment, in a folder called experiment")  # fmt: skip
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
