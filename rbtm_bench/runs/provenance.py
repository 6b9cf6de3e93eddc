"""Where a run's numbers come from: versions, host, command, data."""

from __future__ import annotations

import datetime
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rbtm_bench import __version__
from rbtm_bench.datasets import summary
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.runs.first_part import Determined, filled
from rbtm_bench.runs.replicate import moved_settings
from rbtm_bench.runs.settings import Settings

PACKAGES = ("numpy", "scipy", "open3d", "kiss-icp", "evo", "hydra-core")


def of_run(
    settings: Settings,
    dataset: Dataset | None,
    core: int | None,
    determined: Determined | None = None,
) -> dict[str, Any]:
    """The head of ``run.json``, status "started"; ``determined``: what followed from the data."""
    values = determined.values if determined else {}
    return {
        "status": "started",
        "reason": None,
        "started": now(),
        "finished": None,
        "seconds": None,
        "choices": settings.choices,
        "overrides": list(settings.overrides),
        "special": {key: kind.name for key, kind in settings.special.items()},
        "idle": list(settings.idle),
        "control": settings.control,
        "seed": settings.config["seed"],
        "determined": values,
        "replicate": None if dataset is None else _replicate(settings, dataset, values),
        "scans": len(dataset) if dataset is not None else None,
        "skipped_records": dataset.skipped if dataset is not None else None,
        "readings": [
            *(summary.head(dataset) if dataset is not None else []),
            *(determined.words if determined else ()),
        ],
        "dataset_fingerprint": dataset.fingerprint() if dataset is not None else None,
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "core": core,
        "versions": {"rbtm_bench": __version__, "python": platform.python_version(), **packages()},
        "git": git_hash(),
        "host": platform.node(),
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
    }


def _replicate(
    settings: Settings, dataset: Dataset, determined: Mapping[str, float]
) -> dict[str, Any] | None:
    """What a replicate was given; None for a run on the data and settings as they are."""
    if dataset.draw is None:
        return None
    return {
        **dataset.draw,
        "settings": moved_settings(filled(settings.config, determined), dataset),
    }


def packages() -> dict[str, str | None]:
    """Installed versions of the libraries that make the numbers."""
    versions: dict[str, str | None] = {}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    return versions


def versions_of(requires: tuple[str, ...]) -> dict[str, str | None]:
    """What a registration's last bits depend on: the backend's packages, what we evaluate with,
    and the processor, whose instructions the libraries choose by."""
    versions: dict[str, str | None] = {"rbtm_bench": __version__, "cpu": processor()}
    for module in ("numpy", "scipy", *requires):
        try:
            versions[module] = version(module.replace("_", "-"))
        except PackageNotFoundError:
            versions[module] = None
    return versions


def processor() -> str:
    """The processor's model, as the system names it."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            for line in file:
                if line.startswith("model name"):
                    return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def git_hash() -> str | None:
    """Commit of the checkout that this package runs from, with "+" for local changes."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    try:
        describe = ["git", "describe", "--always", "--dirty=+", "--abbrev=12", "--exclude=*"]
        done = subprocess.run(describe, cwd=root, capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None


def now() -> str:
    """The time in ISO 8601, to the second, with its zone."""
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")
