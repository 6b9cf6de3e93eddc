"""The words of the command line mean what they say: paths, names and whole numbers as typed."""

from __future__ import annotations

import os
import subprocess
import sys
import types
import typing
from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.runs.declared import PLUGIN_GROUPS
from rbtm_bench.runs.plugins import constructor_parameters
from rbtm_bench.runs.settings import compose_settings, member_nodes
from rbtm_bench.runs.words import TEXT, as_typed

QUIET = ["backend=none", "selector=previous", "pictures=false", "pin=false"]


@pytest.fixture(autouse=True)
def unpinned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rbtm_bench.runs.pinning.pin_to_free_core", lambda: None)


def clouds(folder: Path) -> Path:
    folder.mkdir(parents=True)
    for number in range(3):
        points = np.random.default_rng(number).uniform(-5, 5, (50, 3))
        np.save(folder / f"{number}.npy", points)
    return folder


def test_every_setting_that_is_text_is_known() -> None:
    """A setting of ours that takes a text which is no choice of a few is in the list."""
    found = set()
    for group in PLUGIN_GROUPS:
        for name, node in member_nodes(group).items():
            assert isinstance(node, dict)
            for key, parameter in constructor_parameters(name, str(node["_target_"])).items():
                kinds = typing.get_args(parameter.annotation)
                is_union = isinstance(parameter.annotation, types.UnionType)
                if parameter.annotation is str or (is_union and str in kinds):
                    found.add(f"{group}.{key}")
    assert found == TEXT - {"pairs.folder", "out", "selector.gaps_from", "selector.gaps_sha256"}


@pytest.mark.parametrize(
    "name", ["2011_09_26", "1e3", "00", "größe", "a b", "a=b (1)", "true", "it's", "x#y", "50%"]
)
def test_paths_as_they_are(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    clouds(tmp_path / name)
    words = as_typed(["dataset=cloud_folder", f"dataset.path={name}", "out=null"])
    settings = compose_settings(words)
    assert settings.config["dataset"]["path"] == name and settings.config["out"] is None
    assert main(["run", name, *QUIET, "out=a"]) == 0
    assert main(["run", "dataset=cloud_folder", f"dataset.path={name}", *QUIET, "out=b"]) == 0
    assert (tmp_path / "a" / "metrics.json").is_file()


def test_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert as_typed(["dataset.path=~/logs"]) == [f"dataset.path={tmp_path}/logs"]
    assert as_typed(["~metrics.ape", "out='~'", "out=[a]", "x.path=~"]) == [
        "~metrics.ape",
        "out='~'",
        "out=[a]",
        "x.path=~",
    ]


def test_lists_stay_lists() -> None:
    assert as_typed(["dataset.path=2011_09_26,b,ü"]) == ["dataset.path='2011_09_26',b,'ü'"]


@pytest.mark.parametrize(("word", "value"), [("00", 0), ("04", 4), ("1e1", 10), ("7", 7)])
def test_whole_numbers(word: str, value: int) -> None:
    words = ["dataset=kitti", "dataset.path=x", f"dataset.sequence={word}"]
    sequence = compose_settings(words).config["dataset"]["sequence"]
    assert sequence == value and isinstance(sequence, int)


def test_a_hint_has_the_word_as_typed() -> None:
    words = ["dataset=kitti", "dataset.path=x", "dataset.sequence=-1e0"]
    with pytest.raises(ConfigError, match=r"^dataset\.sequence=-1e0: "):
        compose_settings(words)


def test_umlauts_in_a_posix_locale(tmp_path: Path) -> None:
    clouds(tmp_path / "größe")
    command = [sys.executable, "-m", "rbtm_bench", "run", "größe", *QUIET, "out=straße"]
    env = {**os.environ, "LC_ALL": "POSIX"}
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "straße" / "metrics.json").is_file()
