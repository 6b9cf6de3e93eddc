"""Campaigns: runs that exist stay, failed ones are reported, other versions' runs go."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rbtm_bench.engine import drive
from rbtm_bench.runs.grid import Point, make_points
from rbtm_bench.studies.campaign import STAMP, Campaign, begin

WORDS = ["backend=none", "dataset=corridor", "dataset.scans=12", "pictures=false"]


def points(*words: str) -> list[Point]:
    return make_points([*WORDS, *words])[0]


def test_a_second_call_makes_only_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = points("seed=0,1")
    with drive.make_crew(1) as crew:
        campaign = Campaign(tmp_path, crew)
        campaign.make("first", [first])
        record = tmp_path / first.name / "run.json"
        stamp = record.stat().st_mtime_ns
        campaign.make("second", [first, second])
    assert campaign.made == 2
    assert campaign.failed == {}
    assert record.stat().st_mtime_ns == stamp
    out = capsys.readouterr().out
    assert "first: 1 runs, 0 of them there" in out
    assert "second: 2 runs, 1 of them there" in out


def test_a_run_of_other_settings_is_made_again(tmp_path: Path) -> None:
    first, other = points()[0], points("dataset.scans=13")[0]
    other = Point(first.name, other.settings)
    with drive.make_crew(1) as crew:
        campaign = Campaign(tmp_path, crew)
        campaign.make("first", [first])
        campaign.make("other", [other])
    assert campaign.made == 2
    assert json.loads((tmp_path / first.name / "run.json").read_text())["scans"] == 13


def test_a_failed_run_is_told_and_tried_again(tmp_path: Path) -> None:
    point = points("time_limit=0.000001")[0]
    with drive.make_crew(1) as crew:
        campaign = Campaign(tmp_path, crew)
        campaign.make("too slow", [point])
        campaign.make("again", [point])
    assert campaign.made == 2
    assert list(campaign.failed) == [point.name]
    assert "time" in campaign.failed[point.name]


def test_runs_of_other_versions_go(tmp_path: Path) -> None:
    def make() -> int:
        begin(tmp_path, fresh=False)
        with drive.make_crew(1) as crew:
            campaign = Campaign(tmp_path, crew)
            campaign.make("runs", points())
        return campaign.made

    assert make() == 1
    assert make() == 0
    stamp = json.loads((tmp_path / STAMP).read_text())
    stamp["versions"]["open3d"] = "0.0.1"
    (tmp_path / STAMP).write_text(json.dumps(stamp))
    assert make() == 1


def test_fresh_keeps_nothing(tmp_path: Path) -> None:
    begin(tmp_path, fresh=False)
    run, other = tmp_path / "run", tmp_path / "notes"
    run.mkdir()
    other.mkdir()
    (run / "run.json").write_text("{}")
    (other / "mine.txt").write_text("kept")
    begin(tmp_path, fresh=True)
    assert not run.exists()
    assert (other / "mine.txt").read_text() == "kept"
