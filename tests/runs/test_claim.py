"""A results folder belongs to one process at a time; two that begin together lose nothing."""

from __future__ import annotations

import multiprocessing
from pathlib import Path

import pytest
from sweep_helpers import begin

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.runs.claim import claimed, new_folder

STARTS = 100


def _claim(barrier, results, root: str, number: int) -> None:
    """Claim each of the folders at the same moment as the other process, and write into it."""
    won = []
    for i in range(STARTS):
        out = Path(root) / str(i)
        barrier.wait()
        try:
            with claimed(out, overwrite=False):
                (out / "file").write_text(str(number))
                won.append(i)
                barrier.wait()
        except ConfigError:
            barrier.wait()
    results.put((number, won))


def test_of_two_that_begin_together_one_is_refused(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    barrier, results = context.Barrier(2, timeout=60), context.Queue()
    both = [
        context.Process(target=_claim, args=(barrier, results, str(tmp_path), n)) for n in (0, 1)
    ]
    for process in both:
        process.start()
    won = dict(results.get(timeout=120) for _ in both)
    for process in both:
        process.join()
    assert sorted(won[0] + won[1]) == list(range(STARTS))
    for number, folders in won.items():
        assert all((tmp_path / str(i) / "file").read_text() == str(number) for i in folders)


def _new(barrier, results, stem: str) -> None:
    names = []
    for i in range(STARTS):
        barrier.wait()
        names.append(new_folder(f"{stem}{i}").name)
    results.put(names)


def test_new_folders_are_never_the_same(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    barrier, results = context.Barrier(3, timeout=60), context.Queue()
    three = [
        context.Process(target=_new, args=(barrier, results, str(tmp_path / "r"))) for _ in range(3)
    ]
    for process in three:
        process.start()
    names = [name for _ in three for name in results.get(timeout=120)]
    for process in three:
        process.join()
    assert len(set(names)) == len(names) == 3 * STARTS


def test_a_folder_is_left_as_it_was(tmp_path: Path) -> None:
    with claimed(tmp_path / "a" / "b", overwrite=False):
        pass
    assert not (tmp_path / "a" / "b").exists()  # nothing was written
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    full = claimed(tmp_path / "full", overwrite=False)
    with pytest.raises(ConfigError, match="already holds files"), full:
        pass
    with claimed(tmp_path / "full", overwrite=True):
        pass
    assert (tmp_path / "full" / "mine").exists()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["run", "compare", "sweep"])
def test_two_commands_with_one_folder(command: str, tmp_path: Path) -> None:
    words = ["backend=none", "selector=previous", "dataset.scans=40", f"out={tmp_path / 'o'}"]
    two = [begin(command, *words, f"seed={seed}") for seed in (1, 2)]
    errors = [process.communicate(timeout=120)[1] for process in two]
    assert sorted(process.returncode for process in two) == [0, 2], errors
    (refused,) = (e for e, p in zip(errors, two, strict=True) if p.returncode)
    last = refused.splitlines()[-1]
    assert "already holds files" in last or "at work there" in last
    kept = {(p.parent.name, p.read_text().count('"seed": 1')) for p in tmp_path.rglob("run.json")}
    assert len(kept) == 1  # the runs of one command alone


def test_a_run_that_cannot_be_read_is_a_row(tmp_path: Path) -> None:
    from sweep_helpers import call

    small = ["backend=none", "selector=previous", "dataset.scans=6"]
    for name in ("a", "b"):
        assert call("run", *small, f"out={tmp_path / name}")[0] == 0
    (tmp_path / "b" / "metrics.json").write_text('{"a":')
    code, out, _ = call("table", str(tmp_path), "--format", "csv")
    assert code == 0
    rows = {line.split(",")[0]: line for line in out.splitlines()}
    assert ",unreadable," in rows["b"] and "metrics.json: not readable as JSON" in rows["b"]
    assert call("table", str(tmp_path), "--best")[0] == 0
    assert call("plot", str(tmp_path), "--out", str(tmp_path / "figures"))[0] == 0
    code, _, error = call("table", str(tmp_path / "b"))
    assert code == 2 and "metrics.json" in error
