"""The plug-ins under test: looked up by name in the config groups, built as a run builds them."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from rbtm_bench.core import wording
from rbtm_bench.core.errors import ConfigError, RbtmBenchError, one_line
from rbtm_bench.runs import declared, plugins, settings
from rbtm_bench.runs.assembly import build

REQUIRED = {
    ("selector", "random_gap"): ("selector.gaps=[1,2,3]",),
    ("selector", "shifted_gap"): ("selector.gaps=[1,2,3]",),
}
"""Settings without a default that a plug-in of ours cannot do without."""


class Member(NamedTuple):
    """One plug-in: ``group=name``."""

    group: str
    name: str

    def __str__(self) -> str:
        return f"{self.group}={self.name}"


@dataclass(frozen=True)
class Catalogue:
    """What there is to test. ``only``: the plug-ins asked for by name, empty for all."""

    folders: tuple[Path, ...] = ()
    only: tuple[Member, ...] = ()
    overrides: tuple[str, ...] = ()

    @classmethod
    def of_options(
        cls, folders: Iterable[Path], plugins: Iterable[str], overrides: Iterable[str]
    ) -> Catalogue:
        """From the words of the command line. Raises ``ConfigError`` for a wrong one."""
        places = tuple(folder.resolve() for folder in folders)
        for place in places:
            if not place.is_dir():
                raise ConfigError(f"--config-dir {place}: no such folder")
        only = tuple(_member(word, places) for word in plugins)
        words = tuple(overrides)
        for word in words:
            if "=" not in word:
                raise ConfigError(f"--override {word}: expected KEY=VALUE")
        return cls(places, only, words)

    def members(self, group: str, systems: bool = False) -> list[Member]:
        """Every member of a group; of the backends either those that register pairs, or systems."""
        every = [Member(group, name) for name in _names(group, self.folders)]
        return [m for m in every if group != "backend" or self._is_system(m) == systems]

    def wants(self, member: Member) -> bool:
        """Whether this plug-in is to be tested."""
        return not self.only or member in self.only

    def node(self, member: Member, *words: str) -> dict[str, Any]:
        """The member's checked config with ``words`` as overrides. Raises ``ConfigError``."""
        asked = [
            word
            for word in self.overrides
            if word.split(".")[0] == member.group
            or word.split(".")[0].split("=")[0] not in declared.PLUGIN_GROUPS
        ]
        words = (str(member), *REQUIRED.get(member, ()), *words, *asked)
        return dict(_config(words, self.folders)[member.group])

    def build(self, member: Member, *words: str) -> Any:
        """The member, instantiated. Fails the test, saying why, if that cannot be done."""
        try:
            node = self.node(member, *words)
            self._skip_without_packages(member, node)
            return build(node)
        except RbtmBenchError as error:
            pytest.fail(f"{member} cannot be built: {error}", pytrace=False)

    def check_libraries(self) -> None:
        """Raise ``ConfigError``, one line instead of a failure a test, if a plug-in that is asked
        for by name cannot be loaded, or what it ``requires`` is there but broken."""
        for member in self.only:
            cls = plugins.locate(str(member), str(self.node(member)["_target_"]))
            for package in getattr(cls, "requires", ()):
                try:
                    importlib.import_module(package)
                except KeyboardInterrupt:
                    raise
                except BaseException as error:  # a library may leave by sys.exit
                    why = f"{type(error).__name__}: {one_line(error)}"
                    raise ConfigError(
                        f"{member}: the library itself is broken, not the plug-in: "
                        f"import {package}: {why}"
                    ) from error

    def _is_system(self, member: Member) -> bool:
        try:
            return plugins.is_system({"backend": self.node(member)})
        except ConfigError:  # reported where it is built
            return False

    def _skip_without_packages(self, member: Member, node: dict[str, Any]) -> None:
        cls = plugins.locate(str(member), str(node["_target_"]))
        absent = [p for p in getattr(cls, "requires", ()) if importlib.util.find_spec(p) is None]
        if absent and member not in self.only:
            pytest.skip(f"{member} needs {', '.join(absent)}")


CATALOGUE = pytest.StashKey[Catalogue]()
"""Where pytest's config keeps it."""


def _member(word: str, folders: tuple[Path, ...]) -> Member:
    """``GROUP=NAME`` as a member that exists."""
    group, _, name = word.partition("=")
    if group not in declared.PLUGIN_GROUPS:
        raise ConfigError(
            f"--plugin {word}: expected GROUP=NAME."
            f"{wording.suggestion(group, list(declared.PLUGIN_GROUPS))}"
        )
    known = _names(group, folders)
    if name not in known:
        raise ConfigError(f"--plugin {word}: no such {group}.{wording.suggestion(name, known)}")
    return Member(group, name)


@cache
def _names(group: str, folders: tuple[Path, ...]) -> list[str]:
    return settings.members(group, folders)


@cache
def _config(words: tuple[str, ...], folders: tuple[Path, ...]) -> dict[str, Any]:
    return settings.compose_settings(list(words), folders).config
