"""Logs that are published: what they are, where they lie on this machine, and what they hold.

The six logs of the SLAM benchmark of Kuemmerle et al. (2009) with their relations; ``download``
fetches them, and ``dataset=aces`` reads one.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.wording import suggestion
from rbtm_bench.datasets.files import unpacked_lines

DATA = "RBTM_BENCH_DATA"
"""The environment variable that says where data are."""
SERVER = "http://ais.informatik.uni-freiburg.de/slamevaluation/datasets/"
LICENCE = "CC BY 3.0"
CITATION = (
    "R. Kuemmerle, B. Steder, C. Dornhege, M. Ruhnke, G. Grisetti, C. Stachniss, A. Kleiner: "
    "On measuring the accuracy of SLAM algorithms. Autonomous Robots 27 (2009), 387-407."
)
PACKED = ("", ".gz", ".bz2")
RECORDS = ".sha256"
"""A file's name with this holds the hash of its first download."""


@dataclass(frozen=True)
class Remote:
    """A file on the server, as it is unpacked: ``size`` (bytes) and ``sha256`` where known."""

    name: str
    size: int | None = None
    sha256: str | None = None


@dataclass(frozen=True)
class Published:
    """A log with its relations, in words and as files."""

    words: str
    log: Remote
    relations: Remote

    @property
    def files(self) -> tuple[Remote, Remote]:
        return self.log, self.relations


PUBLISHED = {
    "aces": Published(
        "ACES building, Austin (Patrick Beeson)",
        Remote(
            "aces.clf",
            8162333,
            "1b6a069ebbfe261f2bae8bfe1ee91426932d2b964e8c2c0927b15663a4297390",
        ),
        Remote(
            "aces.relations",
            99426,
            "11a15800a751b6f9413078a021d49c7cda85a768c2a465433b4fae7ef57b03d5",
        ),
    ),
    "intel": Published(
        "Intel Research Lab, Seattle (Dirk Haehnel)",
        Remote(
            "intel.clf",
            16433447,
            "8db0ad6231b48bad4118e6a2dc78e83213b2c306be3b4ed80a90969891abfe7b",
        ),
        Remote(
            "intel.relations",
            265713,
            "330378f153eeae652d6756c1746f335801f66c3e097d90611548e6c4f593c359",
        ),
    ),
    "mit-csail": Published(
        "MIT CSAIL building (Cyrill Stachniss)",
        Remote(
            "mit-csail.clf",
            3843167,
            "f40f31cf9e561cb2a0cb0ca2f4a809abb319543cd1b2875f6c8c6a0138559ca4",
        ),
        Remote(
            "mit-csail.relations",
            98468,
            "ffd7ebe97fa1738913931e39ca643ee0a1b67de80499b0197a3d01abad0f589d",
        ),
    ),
    "mit-killian": Published(
        "MIT Killian Court, the infinite corridor (Mike Bosse and John Leonard)",
        Remote("mit-killian.clf"),
        Remote("mit-killian.relations"),
    ),
    "fr079": Published(
        "Freiburg indoor building 079 (Cyrill Stachniss)",
        Remote("fr079.clf"),
        Remote("fr079.relations"),
    ),
    "fr-clinic": Published(
        "Freiburg University Hospital (Bastian Steder and others)",
        Remote("fr-clinic_robotlaser.clf"),
        Remote("fr-clinic.relations"),
    ),
}


def published(name: str) -> Published:
    """The log called ``name``. Raises ``ConfigError`` for an unknown one, with those known."""
    if name not in PUBLISHED:
        raise ConfigError(f"{name}: no such published log.{suggestion(name, list(PUBLISHED))}")
    return PUBLISHED[name]


def home() -> Path:
    """The folder that downloads go to: RBTM_BENCH_DATA, else the user's cache folder."""
    given = os.environ.get(DATA)
    cache = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return (Path(given) if given else Path(cache) / "rbtm_bench").expanduser()


def present(file: Remote, folder: Path | None = None) -> Path | None:
    """Where a file is, plain or packed: in ``folder`` (``home()``) or in freiburg/ below it."""
    folder = home() if folder is None else folder
    places = [
        place / f"{file.name}{end}" for place in (folder / "freiburg", folder) for end in PACKED
    ]
    return next((place for place in places if place.is_file()), None)


def path_of(name: str, part: str) -> str:
    """The path of a published log ("log") or its relations ("relations"), for the settings.

    Raises ``ConfigError`` that says how to get it where it is not there.
    """
    file: Remote = getattr(published(name), part)
    path = present(file)
    if path is None:
        raise ConfigError(
            f"{file.name} is not in {home()}: get it with rbtm-bench download {name}, "
            f"or set {DATA} to the folder that has it"
        )
    return str(path)


def content_sha256(path: Path) -> str:
    """sha256 (hex) of what a file holds, unpacked. Raises ``DataError`` for a damaged archive."""
    digest = hashlib.sha256()
    for _ in unpacked_lines(path, digest):
        pass
    return digest.hexdigest()


def recorded(path: Path) -> str | None:
    """The hash of the first download of a file beside it, or None. Raises ``DataError`` for a
    record that is none."""
    record = path.with_name(path.name + RECORDS)
    if not record.is_file():
        return None
    words = record.read_text(encoding="latin-1").split()
    if not words or len(words[0]) != 64:
        raise DataError(f"{record}: expected a sha256 and a name")
    return words[0]


def state(name: str) -> str:
    """In a few words whether a published log is on this machine."""
    paths = [present(file) for file in published(name).files]
    if None not in paths:
        return f"present, {paths[0]}"
    lacking = [f.name for f, path in zip(published(name).files, paths, strict=True) if path is None]
    missing = "" if len(lacking) == 2 else f", lacks {lacking[0]}"
    return f"not present{missing}: rbtm-bench download {name}"
