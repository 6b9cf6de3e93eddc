"""``perturb`` as a setting: swept, part of what a run is, and nothing where it is zero."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from sweep_helpers import call, record_of

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.runs import experiment, stored
from rbtm_bench.runs.declared import PERTURB
from rbtm_bench.runs.settings import Settings, compose_settings
from rbtm_bench.runs.workbench import Workbench

SHORT = ["dataset.scans=16", "dataset.beams=121", "pictures=false"]


def settings(*words: str) -> Settings:
    return compose_settings([*SHORT, *words])


def test_it_is_swept_like_any_setting(tmp_path: Path) -> None:
    words = ["backend=plicp,none", "selector=previous", "perturb.dropout=0,0.3", *SHORT]
    code, out, error = call("compare", *words, f"out={tmp_path / 'c'}", "-j", "1")
    assert code == 0, error
    assert "corridor perturb.dropout=0.3" in out
    names = {f"{b}-previous-dropout={d}" for b in ("plicp", "none") for d in ("0", "0.3")}
    assert names <= {folder.name for folder in (tmp_path / "c").iterdir()}
    prints = {name: record_of(tmp_path / "c" / name)["dataset_fingerprint"] for name in names}
    assert len(set(prints.values())) == 2
    rows = list(csv.DictReader((tmp_path / "c" / "summary.csv").open()))
    assert len(rows) == 4 and {row["data"] for row in rows} == {
        "corridor",
        "corridor perturb.dropout=0.3",
    }
    record = record_of(tmp_path / "c" / "plicp-previous-dropout=0.3")
    assert any("dropout 0.3" in line for line in record["readings"])


def test_zero_is_the_run_as_it_is(tmp_path: Path) -> None:
    plain, zero = settings("backend=plicp"), settings("backend=plicp", "perturb.dropout=0")
    assert plain.config["perturb"] == PERTURB
    assert plain.identity.run == zero.identity.run
    assert not any("perturb" in key for key in plain.identity.data)
    for name, one in (("plain", plain), ("zero", zero)):
        experiment.run(one, tmp_path / name)
    files = [tmp_path / name / "trajectory.tum" for name in ("plain", "zero")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_it_is_other_data_for_the_same_way() -> None:
    plain, lost = settings(), settings("perturb.dropout=0.1")
    assert plain.identity.way == lost.identity.way
    assert plain.identity.dataset != lost.identity.dataset
    assert plain.identity.method != lost.identity.method
    seeds = [settings("perturb.dropout=0.1", f"seed={seed}").identity for seed in (0, 1)]
    assert seeds[0].method == seeds[1].method and seeds[0].run != seeds[1].run


def test_a_run_is_read_back_as_it_was(tmp_path: Path) -> None:
    one = settings("backend=none", "perturb.movers=2")
    experiment.run(one, tmp_path / "run")
    assert stored.read_run(tmp_path / "run").identity.run == one.identity.run


def test_shared_work_gives_the_same_bits_and_replicates_follow(tmp_path: Path) -> None:
    bench, prints = Workbench(), []
    for words in (["perturb.dropout=0.2"], [], ["perturb.dropout=0.2", "replicate=1"]):
        one = settings("backend=plicp", *words, "overwrite=true")
        experiment.run(one, tmp_path / "alone")
        experiment.run(one, tmp_path / "shared", bench=bench)
        files = [tmp_path / f / "trajectory.tum" for f in ("alone", "shared")]
        assert files[0].read_bytes() == files[1].read_bytes()
        prints.append(record_of(tmp_path / "shared")["dataset_fingerprint"])
    assert len(set(prints)) == 3
    assert record_of(tmp_path / "shared")["replicate"]["of"] == prints[0]


@pytest.mark.parametrize(
    "word", ["perturb.dropout=1", "perturb.every_scan=0", "perturb.movers=-1", "+perturb.rain=1"]
)
def test_what_is_no_such_setting(word: str) -> None:
    with pytest.raises(ConfigError, match="perturb"):
        settings(word)
