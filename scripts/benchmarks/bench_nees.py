"""Are covariances honest? The normalised estimation error squared (NEES) of every backend that
gives one, against exact truth.

A row a place and backend: NEES over its degrees of freedom (1: honest; above: too sure of itself)
with the bounds that 95 % of honest methods keep, and the share of errors inside their 95 %
ellipsoid, over all registrations and over those without the wrong matches (more than 0.1 m or 2 deg
off). "localizability" rows are the covariances that selectors take (docs/selection.md).

    python scripts/benchmarks/bench_nees.py                   simulated places, planar and in space
    python scripts/benchmarks/bench_nees.py --backends plicp,ndt_2d --draws 20 --places bare

Simulations only: the truth of a log has errors as large as a registration's. Every seed draws its
own noise of the same pairs of poses; scans of different pairs are different ones. The error is
taken in the tangent at the estimate, T exp(d) = truth, where covariances are declared. Motions that
fewer than 1 % of the matched points oppose (a bare corridor's axis) are left out: 3 or 6 degrees of
freedom less those.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rbtm_bench.backends.base import Backend
from rbtm_bench.calibration.guesses import disturbed
from rbtm_bench.calibration.known_pairs import errors_of
from rbtm_bench.core.columns import DEGENERATE
from rbtm_bench.core.errors import BackendError, ConfigError
from rbtm_bench.core.files import make_folder, write_text
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, RegistrationResult
from rbtm_bench.core.uncertainty import PLANE, SPACE, edge_covariance, inflated, nees, tangent_error
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.engine.progress import bar
from rbtm_bench.odometry import judge
from rbtm_bench.runs import assembly, settings
from rbtm_bench.runs.pinning import pin_to_free_core

PLANAR = ["dataset=corridor", "dataset.scans=41"]
SPATIAL = ["dataset=simulated", "dataset.scans=12", "dataset.beams=16", "dataset.azimuths=360"]
PLACES = {
    **{e: [*PLANAR, f"dataset.environment={e}"] for e in ("paper", "cluttered", "l_turn", "bare")},
    **{p: [*SPATIAL, f"dataset.place={p}"] for p in ("office", "hall", "tunnel")},
}
GAP, PAIRS = 1, 4
WRONG = (0.1, 2.0)
"""m and deg from the truth, from which on a match is wrong."""
GUESS = (0.05, 2.0)
"""Error of the guess, m and deg."""
OWN, JUDGED, FLOORED = "own", "localizability", "localizability, floored"


@dataclass(frozen=True)
class Outcome:
    """A registration: its NEES, the degrees of freedom, and whether it is a wrong match."""

    value: float
    freedom: int
    wrong: bool


@dataclass(frozen=True)
class Consistency:
    """``ratio``: NEES over degrees of freedom, which lies between ``low`` and ``high`` for 95 % of
    honest methods; ``inside``: the share within the 95 % ellipsoid, with its interval."""

    n: int
    ratio: float
    low: float
    high: float
    inside: float
    inside_low: float
    inside_high: float

    def words(self) -> list[str]:
        return [
            f"{self.ratio:.3g}",
            f"[{self.low:.2f}, {self.high:.2f}]",
            f"{self.inside:.0%} [{self.inside_low:.0%}, {self.inside_high:.0%}]",
        ]


def consistency(values: Sequence[float], freedom: Sequence[int]) -> Consistency:
    """Of independent NEES values (n,) with their degrees of freedom (n,): a sum of chi-squares is
    chi-square of the sum of their degrees; a share is binomial (Wilson's interval)."""
    from scipy.stats import binomtest, chi2

    v, k = np.asarray(values, np.float64), np.asarray(freedom)
    total = int(k.sum())
    low, high = chi2.ppf([0.025, 0.975], total) / total
    inside = int((v <= chi2.ppf(0.95, k)).sum())
    ends = binomtest(inside, len(v)).proportion_ci(method="wilson")
    share = inside / len(v)
    return Consistency(
        len(v), float(v.sum() / total), float(low), float(high), share, ends.low, ends.high
    )


def seen_by(result: RegistrationResult, axes: list[int]) -> Array:
    """The motions (n, k) that the matched points oppose, of the small motion d."""
    held = result.localizability
    if held is None:
        return np.zeros((len(axes), 0))
    values, vectors = held.axes
    scale = np.where(np.array(axes) < 3, 1.0, 1.0 / held.lever)
    return scale[:, None] * vectors[:, values >= DEGENERATE]


def informations(result: RegistrationResult, planar: bool) -> Iterator[tuple[str, Array]]:
    """The information (6, 6) of a result, its own and ours."""
    if result.information is not None:
        yield OWN, result.information
    ours = edge_covariance(result, planar, "localizability")
    axes = np.ix_(*[PLANE if planar else SPACE] * 2)
    for name, covariance in (
        (JUDGED, ours),
        (FLOORED, inflated(ours, result.T_target_source, planar)),
    ):
        information = np.zeros((6, 6))
        information[axes] = np.linalg.inv(covariance[axes])
        yield name, information


def outcomes(
    backend: Backend, dataset: Dataset, random: np.random.Generator
) -> Iterator[tuple[str, Outcome]]:
    """The registrations of a draw of the noise: pairs of scans that share none."""
    if not dataset.truth_is_exact:
        raise ConfigError("NEES takes an exact truth: simulations only")
    axes = PLANE if dataset.planar else SPACE
    first = np.linspace(0, len(dataset) - 1 - GAP, PAIRS).round().astype(int)
    for i in first.tolist():
        target, source = dataset[i], dataset[i + GAP]
        assert target.ground_truth is not None and source.ground_truth is not None
        truth = inverse(target.ground_truth) @ source.ground_truth
        guess = disturbed(truth[None], *GUESS, dataset.planar, random)[0]
        prepared = [backend.prepare(scan.without_truth()) for scan in (source, target)]
        try:
            result = judge.register(backend, *prepared, guess)
        except BackendError:
            continue
        metres, degrees = errors_of(result.T_target_source, truth)
        error = tangent_error(result.T_target_source, truth)[axes]
        seen = seen_by(result, axes)
        if seen.shape[1]:
            for name, information in informations(result, dataset.planar):
                value = nees(error, information[np.ix_(axes, axes)], seen)
                wrong = metres > WRONG[0] or degrees > WRONG[1]
                yield name, Outcome(value, seen.shape[1], wrong)


def rows(place: str, names: Sequence[str], draws: int, told: Any) -> Iterator[dict[str, str]]:
    """A row a backend and covariance of a place."""
    for name in names:
        words = [*PLACES[place], f"backend={name}"]
        config = settings.compose_settings(words).config
        dataset = assembly.build(config["dataset"])
        backend = assembly.build(config["backend"])
        if ("2d" if dataset.planar else "3d") not in backend.dimensions or backend.is_baseline:
            continue
        by_name: dict[str, list[Outcome]] = {}
        for draw in range(draws):
            told(f"{place}, {name}")
            data = assembly.build({**config["dataset"], "seed": draw})
            for kind, outcome in outcomes(backend, data, np.random.default_rng([draw, 7])):
                by_name.setdefault(kind, []).append(outcome)
            if OWN not in by_name:
                break  # it gives none
        if OWN in by_name:
            for kind, several in by_name.items():
                yield row(place, name, kind, several)


def row(place: str, name: str, kind: str, several: Sequence[Outcome]) -> dict[str, str]:
    right = [o for o in several if not o.wrong]
    cells = {"place": place, "backend": name, "covariance": kind}
    cells["freedom"] = f"{np.mean([o.freedom for o in several]):.3g}"
    cells["wrong"] = f"{len(several) - len(right)} of {len(several)}"
    for label, some in (("", several), (", right", right)):
        words = ["", "", ""]
        if some:
            words = consistency([o.value for o in some], [o.freedom for o in some]).words()
        cells |= dict(zip((f"NEES{label}", f"bounds{label}", f"inside{label}"), words, strict=True))
    return cells


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print the table, write it as CSV and Markdown."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--backends", default=None, help="names, by commas (default: all)")
    parser.add_argument("--places", default=",".join(PLACES), help="of " + ", ".join(PLACES))
    parser.add_argument("--draws", type=int, default=50, help="draws of the noise (default 50)")
    parser.add_argument("--out", type=Path, default=Path("results/nees"))
    options = parser.parse_args(argv)
    places = options.places.split(",")
    if unknown := [place for place in places if place not in PLACES]:
        parser.error(f"--places {unknown[0]}: expected one of {', '.join(PLACES)}")
    every = [name for name in settings.members("backend") if not name.endswith("_system")]
    names = options.backends.split(",") if options.backends else every
    pin_to_free_core()
    make_folder(options.out)
    made: list[dict[str, str]] = []
    with bar("nees") as progress:
        for place in places:  # what is measured stays if it is stopped
            made += rows(place, names, options.draws, progress.step)
            table = pd.DataFrame(made)
            table.to_csv(options.out / "nees.csv", index=False)
            write_text(options.out / "nees.md", table.to_markdown(index=False) + "\n")
    text = table.to_markdown(index=False)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
