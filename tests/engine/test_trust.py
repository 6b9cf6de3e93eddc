"""A sweep's folder from somebody else: what --resume does not do of its own accord."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import pytest
from sweep_helpers import call

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.engine import sweep_folder
from rbtm_bench.engine.sweep_folder import Asked


def asked(*overrides: str, dirs: tuple[str, ...] = (), cwd: str | None = None) -> Asked:
    now = Asked.now("compare", [], list(overrides), dirs, False)
    return dataclasses.replace(now, cwd=cwd or now.cwd)


EVIL = (
    "backend._target_=os.system",
    "+x={_target_: subprocess.call, args: [ls]}",
    "+x={'_target_': 'pickle.loads'}",
    "dataset._target_=rbtm_bench_evil.Corridor",
    "hydra.searchpath=[file:///tmp/evil]",
    "hydra.launcher.setup=['rm -rf ~']",
    "hydra.job.env_set.PATH=/tmp",
    "backend=../../../tmp/evil",
    "dataset.path=${oc.env:HOME}",
    "pairs.folder=/home/you/.ssh",
    "pairs.folder=../../elsewhere",
)
GOOD = (
    "backend=none,open3d_p2p",
    "dataset._target_=rbtm_bench.datasets.corridor.Corridor",
    "dataset.path=../logs/aces.clf.gz",
    "hydra/launcher=joblib",
    "hydra.launcher.n_jobs=2",
    "pairs.folder=null",
    "pairs.folder=mine",
    "selector.threshold=${selection.threshold}",
    "+experiment=table1",
)


def test_what_reaches_beyond_our_code_and_the_folder_is_named(tmp_path: Path) -> None:
    assert asked(*EVIL, *GOOD).strange(tmp_path, []) == list(EVIL)
    assert asked(cwd="/").strange(tmp_path, []) == ["the working folder /"]
    dirs = (str(tmp_path / "mine"),)
    assert asked(dirs=dirs).strange(tmp_path, []) == [f"plug-ins from {dirs[0]}"]
    assert asked(dirs=dirs).strange(tmp_path, dirs) == []  # those named now are used instead


@pytest.mark.parametrize("word", EVIL)
def test_resume_asks_for_trust_before_anything_is_composed(word: str, tmp_path: Path) -> None:
    asked("backend=none", word).write(tmp_path)
    before = sorted(os.listdir(tmp_path))
    code, out, err = call("compare", "--resume", str(tmp_path))
    assert code == 2 and not out and len(err.splitlines()) == 1
    assert word in err and "--trust" in err
    assert sorted(os.listdir(tmp_path)) == before


def test_a_pickle_that_a_sweep_names_is_not_run(tmp_path: Path) -> None:
    """The attack itself: a class of the standard library that calls what it is given."""
    ran = tmp_path / "ran"
    evil = f"backend={{_target_: os.system, command: 'touch {ran}'}}"
    asked(evil, "dataset.scans=5").write(tmp_path)
    assert call("compare", "--resume", str(tmp_path))[0] == 2
    assert not ran.exists()


@pytest.mark.parametrize("place", ["run", "file", "pairs"])
def test_resume_follows_no_link(place: str, tmp_path: Path) -> None:
    victim, out = tmp_path / "victim", tmp_path / "out"
    victim.mkdir()
    (victim / "config.yaml").write_text("precious")
    asked("backend=none").write(out)
    if place == "file":
        (out / "none-rbtm").mkdir()
        (out / "none-rbtm" / "config.yaml").symlink_to(victim / "config.yaml")
    else:
        (out / ("pairs" if place == "pairs" else "none-rbtm")).symlink_to(victim)
    code, _, err = call("compare", "--resume", str(out))
    assert code == 2 and "a link; --resume follows none" in err
    assert (victim / "config.yaml").read_text() == "precious"


def test_only_what_a_run_wrote_is_removed(tmp_path: Path) -> None:
    run, link = tmp_path / "run", tmp_path / "link"
    run.mkdir()
    names = ("notes.txt", ".mine.partial.txt", ".12.partial.map.npz", "config.yaml")
    for name in names:
        (run / name).write_text("x")
    link.symlink_to(run)
    sweep_folder.clear([link])
    assert {path.name for path in run.iterdir()} == set(names)
    sweep_folder.clear([run])
    assert {path.name for path in run.iterdir()} == {"notes.txt", ".mine.partial.txt"}


@pytest.mark.parametrize("text", ['{"kind": 1}', '{"overrides": "x"}', "[" * 100_000])
def test_a_sweep_file_of_another_shape_is_one_line(text: str, tmp_path: Path) -> None:
    (tmp_path / sweep_folder.FILE).write_text(text)
    code, _, err = call("compare", "--resume", str(tmp_path))
    assert code == 2 and len(err.splitlines()) == 1 and sweep_folder.FILE in err


def test_words_of_other_types_are_refused(tmp_path: Path) -> None:
    bad = dataclasses.replace(asked(), overrides=[1])  # type: ignore[list-item]
    bad.write(tmp_path)
    with pytest.raises(Exception, match="expected lists of words"):
        Asked.read(tmp_path)
    with pytest.raises(ConfigError, match="no sweep was begun"):
        Asked.read(tmp_path / "none")
