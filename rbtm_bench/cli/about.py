"""The subcommands about the installation: list, doctor."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rbtm_bench.core.errors import ConfigError

LIBRARIES = (
    ("numpy", "numpy"),
    ("scipy", "scipy"),
    ("open3d", "open3d"),
    ("kiss_icp", "kiss-icp"),
    ("hydra", "hydra-core"),
    ("pydantic", "pydantic"),
    ("evo", "evo"),
    ("pandas", "pandas"),
    ("pyarrow", "pyarrow"),
    ("jinja2", "jinja2"),
    ("tabulate", "tabulate"),
    ("matplotlib", "matplotlib"),
    ("joblib", "joblib"),
    ("rich", "rich"),
)
SYSTEM_LIBRARIES = "libusb-1.0-0 libgl1 libegl1 libx11-6 libidn2-0 libudev1"


def list_plugins(words: list[str]) -> int:
    """``rbtm-bench list``: every plug-in, its parameters, and whether its library is installed."""
    from rbtm_bench.core.wording import shown
    from rbtm_bench.datasets.published import PUBLISHED, state
    from rbtm_bench.runs.declared import PLUGIN_GROUPS
    from rbtm_bench.runs.identity import flat
    from rbtm_bench.runs.settings import member_nodes

    parser = argparse.ArgumentParser(
        prog="rbtm-bench list",
        description="Every plug-in of every group with its parameters and their defaults. "
        "'missing' says why one cannot be used.",
    )
    plural = {f"{group}s": group for group in PLUGIN_GROUPS}
    parser.add_argument(
        "group",
        nargs="?",
        choices=PLUGIN_GROUPS,
        metavar="GROUP",
        type=lambda word: plural.get(word, word),
        help=f"only this one: {', '.join(PLUGIN_GROUPS)}",
    )
    parser.add_argument("--config-dir", "-cd", action="append", default=[], type=Path)
    parser.add_argument("--names", action="store_true", help="names only")
    options = parser.parse_args(words)
    extra = tuple(options.config_dir)
    for group in [options.group] if options.group else PLUGIN_GROUPS:
        nodes = member_nodes(group, extra)
        print(f"{group}:")
        for name, node in nodes.items():
            if options.names:
                print(f"  {name}")
                continue
            if group == "dataset" and name in PUBLISHED:  # carmen's parameters, on other files
                print(f"  {name:<18} [{state(name)}] {PUBLISHED[name].words}")
                continue
            print(f"  {name:<18} {_about(group, name, node)}")
            if isinstance(node, dict):
                for key, value in flat(node):
                    print(f"      {group}.{key}={shown(value)}")
    return 0


def _about(group: str, name: str, node: dict[str, Any] | ConfigError) -> str:
    from rbtm_bench.runs.installed import missing_library
    from rbtm_bench.runs.plugins import locate

    why_not = missing_library(group, name, node)
    if why_not or isinstance(node, ConfigError):
        return f"[missing] {why_not}"
    cls = locate(f"{group}={name}", str(node["_target_"]))
    module = sys.modules.get(getattr(cls, "__module__", ""))
    text = (getattr(module, "__doc__", None) or cls.__doc__ or "").strip()
    return text.split("\n\n")[0].replace("\n", " ")


def doctor(words: list[str]) -> int:
    """``rbtm-bench doctor``: what is installed, what is not, and what to do about it."""
    argparse.ArgumentParser(
        prog="rbtm-bench doctor",
        description="Checks Python, libraries, configs, pinning and data; says what to do.",
    ).parse_args(words)
    problems = []
    for check in _checks():
        print(check.line)
        problems += [check.problem] if check.problem else []
    if not problems:
        print("all is well")
        return 0
    print(f"{len(problems)} to mend:")
    for problem in problems:
        print(f"  {problem}")
    return 1


@dataclass(frozen=True)
class _Check:
    """Something that was checked: whether it is good (None if that is a matter of choice), and
    what to do if not."""

    good: bool | None
    what: str
    advice: str = ""

    @property
    def line(self) -> str:
        mark = {True: "ok ", False: "BAD", None: "-- "}[self.good]
        return f"{mark}  {self.what}"

    @property
    def problem(self) -> str | None:
        return f"{self.what}: {self.advice}" if self.good is False else None


def _checks() -> Iterator[_Check]:
    """All checks, each made when it is asked for: importing the libraries takes seconds."""
    version = platform.python_version()
    yield _Check(sys.version_info >= (3, 11), f"Python {version}", "use Python 3.11 or newer")
    yield from _library_checks()
    yield from _plugin_checks()
    yield from _machine_checks()


def _library_checks() -> Iterator[_Check]:
    from importlib.metadata import PackageNotFoundError, version

    from rbtm_bench.core.open3d_library import open3d

    for module, package in LIBRARIES:
        try:
            open3d() if module == "open3d" else importlib.import_module(module)
            yield _Check(True, f"{package} {version(package)}")
        except PackageNotFoundError:
            yield _Check(True, f"{package} (version unknown)")
        except (ImportError, OSError) as error:
            advice = f"pip install {package}"
            if ".so" in str(error):
                advice = f"as root: apt-get install {SYSTEM_LIBRARIES}"
            yield _Check(False, f"{package} cannot be imported ({error})", advice)


def _plugin_checks() -> Iterator[_Check]:
    try:
        from rbtm_bench.runs.declared import PLUGIN_GROUPS
        from rbtm_bench.runs.installed import missing_library
        from rbtm_bench.runs.settings import config_dir, member_nodes
    except ImportError as error:
        yield _Check(False, "plug-ins cannot be listed", f"first mend what is above ({error})")
        return
    yield _Check(
        (config_dir() / "config.yaml").is_file(), f"configs in {config_dir()}", "install again"
    )
    for group in PLUGIN_GROUPS:
        nodes = member_nodes(group)
        absent = {n: why for n in nodes if (why := missing_library(group, n, nodes[n]))}
        for name, why in absent.items():
            yield _Check(False, f"{group}={name} is not usable", why)
        if not absent:
            yield _Check(True, f"{group}: {', '.join(nodes)}")


def _machine_checks() -> Iterator[_Check]:
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
        yield _Check(True, f"{cores} cores; each run can be pinned to one, so numbers repeat")
    else:
        yield _Check(
            None, "this system cannot pin a process to a core: Open3D's last bits may vary"
        )
    data = os.environ.get("RBTM_BENCH_DATA")
    if not data:
        yield _Check(None, "RBTM_BENCH_DATA is not set: tests on real data will be skipped")
        return
    advice = "point it at a folder that holds freiburg/, corrected/ and kitti/"
    yield _Check((Path(data) / "freiburg").is_dir(), f"RBTM_BENCH_DATA={data}", advice)
