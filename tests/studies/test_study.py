"""`rbtm-bench study` end to end, small: equal tries, the choice by hand, resume, the page."""

from __future__ import annotations

import gzip
import itertools
import json
import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from sweep_helpers import TESTS, call

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.runs.settings import compose_settings
from rbtm_bench.runs.stored import read_run
from rbtm_bench.studies import outcome, study_file
from rbtm_bench.studies.plan import ALWAYS, Draw, Method, Plan

PAGE = TESTS.parent / "docs" / "studies.md"
SMALL = {
    "title": "Small",
    "question": "Which?",
    "words": "dataset=corridor dataset.scans=14 dataset.beams=91 guess=odometry",
    "data": {
        "paper": {"words": "dataset.environment=paper", "status": "held out"},
        "bare": "dataset.environment=bare dataset.path_length=1.0",
    },
    "backends": ["open3d_p2p"],
    "tuned": {"key": "registration.max_correspondence_distance", "values": [0.3]},
    "ways": {
        "odometry": {"words": "backend=none selector=previous", "reference": True},
        "previous": {
            "words": "selector=previous",
            "key": "registration.max_correspondence_distance",
            "values": [0.1, 0.5],
        },
        "rbtm": {
            "words": "selector=rbtm selector.window=6 similarity=overlap",
            "key": "selector.threshold",
            "values": [0.5, 0.95],
        },
        "keyframe": {"like": "rbtm", "selector": "keyframe"},
        "shifted": {"like": "rbtm", "selector": "shifted_gap"},
    },
    "ours": ["rbtm"],
    "metric": "final_translation_error_mm",
    "chosen_on": [100, 101],
    "shown": [0, 1, 2],
}


def changed(tmp_path: Path, **keys: object) -> str:
    """The small study as a file, with other keys."""
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump({**SMALL, **keys}, sort_keys=False))
    return str(file)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small study, conducted."""
    root = tmp_path_factory.mktemp("study")
    code, out, error = call("study", changed(root), "--out", str(root / "out"), "-j", "1")
    assert code == 0, error
    assert out.startswith("# Small")
    return root


@pytest.mark.slow
def test_the_chosen_try_and_its_regret_by_hand(folder: Path) -> None:
    table = pd.read_csv(folder / "out" / "table.csv").set_index(["data", "way"])

    def median(data: str, way: str, k: int, seeds: list[int]) -> float:
        names = (f"{data}-open3d_p2p-{way}-{k}-seed{seed}" for seed in seeds)
        runs = [read_run(folder / "out" / "runs" / name) for name in names]
        errors = [run.metrics["final_translation_error_mm"] for run in runs]
        if seeds[0] == 100:  # a ratio counts the same everywhere
            return float(np.mean(np.log(errors)))
        return float(np.median(errors))

    for data, way in itertools.product(("paper", "bare"), ("previous", "rbtm", "keyframe")):
        row = table.loc[data, way]
        scores = [median(data, way, k, [100, 101]) for k in (1, 2)]
        assert row["tries"] == 2
        assert row["chosen"] == 1 + int(np.argmin(scores))
        shown = [median(data, way, k, [0, 1, 2]) for k in (1, 2)]
        assert row["median"] == pytest.approx(shown[int(row["chosen"]) - 1], rel=1e-4)
        assert row["regret"] == pytest.approx(row["median"] / min(shown), rel=1e-3)


@pytest.mark.slow
def test_the_page_marks_its_columns_and_claims_nothing_of_three_seeds(folder: Path) -> None:
    page = (folder / "out" / "README.md").read_text()
    assert "surely" not in page
    assert "rbtm-bench study" in page and "processor time" in page
    heads = [line for line in page.splitlines() if line.startswith("| data") and "rbtm" in line]
    assert heads
    for head in heads:
        cells = [cell.strip() for cell in head.strip("|").split("|")][2:]
        assert all(cell.endswith(("held out, by row)", "(tuned)")) for cell in cells), head
    ratios = pd.read_csv(folder / "out" / "ratios.csv")
    assert set(ratios["other"]) == {"odometry", "previous", "keyframe", "shifted"}
    assert ratios["holds"].isna().all()
    assert (folder / "out" / "deciding.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_study_goes_on_where_it_was_cut(folder: Path) -> None:
    runs = folder / "out" / "runs"
    times = {f: f.stat().st_mtime_ns for f in runs.glob("*/run.json")}
    lost = runs / "paper-open3d_p2p-rbtm-1-seed0"
    (lost / "metrics.json").unlink()
    before = (folder / "out" / "table.csv").read_text()
    code, _, error = call("study", str(folder / "out"), "-j", "1")
    assert code == 0, error
    assert (folder / "out" / "table.csv").read_text() == before
    again = {f.parent.name for f, stamp in times.items() if f.stat().st_mtime_ns != stamp}
    assert again == {lost.name}


@pytest.mark.slow
def test_the_study_of_ones_own_logs_that_the_page_shows(tmp_path: Path, data_dir: Path) -> None:
    (example,) = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(example.splitlines()) <= 20
    assert "replicates: 8" in example  # two are enough to see that it runs
    (tmp_path / "mine.yaml").write_text(example.replace("replicates: 8", "replicates: 2"))
    with gzip.open(data_dir / "freiburg" / "mit-csail.clf.gz", "rt") as log:
        lines = list(itertools.islice(log, 1300))
    for k, name in enumerate(("monday", "tuesday", "friday")):
        with gzip.open(tmp_path / f"{name}.clf.gz", "wt") as part:
            part.writelines(lines[k:])
        relations = (data_dir / "freiburg" / "mit-csail.relations").read_bytes()
        (tmp_path / f"{name}.relations").write_bytes(relations)
    code, out, error = call("study", "mine.yaml", "-j", "1", "dataset.max_scans=90", cwd=tmp_path)
    assert code == 0, error
    assert "Our corridor, three drives" in out and "2 replicates" in out
    table = pd.read_csv(tmp_path / "results" / "studies" / "mine" / "table.csv")
    assert set(table["data"]) == {"monday", "tuesday", "friday"}
    assert table["median"].notna().all()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"metric": "errors"}, r"metric: errors: no such column"),
        ({"wayss": {}}, r"wayss: no such key. Known: title"),
        ({"backends": []}, r"backends: list should have at least 1 item"),
        ({"shown": None}, r"shown: expected either a list of seeds, or replicates"),
        ({"replicates": 3}, r"shown: expected either a list of seeds, or replicates"),
        ({"chosen_on": [2, 3]}, r"chosen_on: seed 2 is shown too"),
        ({"chosen_on": "nowhere"}, r"chosen_on: nowhere, but there are 2 tries"),
        ({"ours": ["mine"]}, r"ours: mine: expected some of ways: odometry, previous"),
        ({"data": {"a b": "dataset=corridor"}}, r"a b: expected a name"),
    ],
)
def test_a_wrong_file_is_one_line(tmp_path: Path, keys: dict[str, object], message: str) -> None:
    code, _, error = call("study", changed(tmp_path, **keys))
    assert code == 2
    assert re.search(rf"mine.yaml: {message}", error), error
    assert len(error.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("way", "message"),
    [
        ({"words": "selector=keyframe"}, r"values: tries: 1, expected 2, as every other"),
        ({"words": "selector=keyframe", "key": "selector.distance"}, r"values: expected key and"),
        ({"like": "other", "selector": "keyframe"}, r"like: other: expected one of odometry"),
        ({"like": "rbtm", "words": "selector=keyframe"}, r"with like: expected selector"),
        ({"words": "selector=keyframe", "selector": "keyframe"}, r"selector: only beside like"),
    ],
)
def test_a_way_with_other_tries_is_refused(
    tmp_path: Path, way: dict[str, object], message: str
) -> None:
    file = changed(tmp_path, ways={**SMALL["ways"], "other": way})  # type: ignore[dict-item]
    with pytest.raises(ConfigError, match=rf"mine.yaml: ways.other(: |.){message}"):
        study_file.load(file, False, [])


def test_tries_that_a_backend_cannot_tell_apart_are_refused(tmp_path: Path) -> None:
    ways = {"one": {"words": "selector=previous"}}
    tuned = {"key": "registration.max_correspondence_distance", "values": [0.1, 0.1]}
    file = changed(tmp_path, ways=ways, ours=["one"], tuned=tuned)
    study = study_file.load(file, False, [])
    with pytest.raises(ConfigError, match=r"ways.one: 2 tries, of which 1 differ"):
        Plan.of(study)


def test_every_shipped_study_is_whole_and_small_with_quick() -> None:
    for name in study_file.names():
        study = study_file.load(name, False, [])
        quick = study_file.load(name, True, ["dataset.beams=61"])
        assert quick.words[-1] == "dataset.beams=61"
        draws = [len(s.shown or range(s.replicates or 0)) for s in (quick, study)]
        assert draws[0] <= draws[1]
        assert len(list(quick.cells())) <= len(list(study.cells()))


def test_axes_make_a_cell_of_every_data_set_at_every_place(tmp_path: Path) -> None:
    axes = {
        "noise": {"key": "dataset.range_noise", "values": [0.0, 0.1], "labels": ["none", "much"]},
        "step": {"key": "dataset.scans", "values": [5, 9, 17]},
    }
    cells = list(study_file.load(changed(tmp_path, axes=axes), False, []).cells())
    assert len(cells) == 12
    label, data, at, words = cells[5]
    assert (label, data, at) == ("paper noise=much step=17", "paper", (1, 2))
    assert words[-2:] == ["dataset.range_noise=0.1", "dataset.scans=17"]


class Known(outcome.Outcome):
    """An outcome whose errors are given."""

    errors: dict[tuple[str, str], list[float]]

    @property
    def chosen(self):  # type: ignore[no-untyped-def, override]
        return {m: outcome.Chosen(0, 1, (1.0,)) for m in self.plan.methods()}

    def values(self, method, k):  # type: ignore[no-untyped-def, override]
        errors = self.errors[method.data, method.way]
        return {Draw("seed", seed): v for seed, v in enumerate(errors) if not math.isnan(v)}


def test_pooled_ratios_weigh_data_sets_alike_and_say_what_is_1_by_construction(
    tmp_path: Path,
) -> None:
    ways = {n: SMALL["ways"][n] for n in ("previous", "rbtm")}  # type: ignore[index]
    data = {name: "dataset.environment=paper" for name in "abc"}
    study = study_file.load(changed(tmp_path, ways=ways, data=data), False, [])
    known = Known(Plan(study, {}, {}, {}), tmp_path)
    nan = math.nan
    known.errors = {
        ("a", "rbtm"): [2.0, 8.0, 4.0], ("a", "previous"): [1.0, 1.0, 1.0],
        ("b", "rbtm"): [3.0, 3.0, 3.0], ("b", "previous"): [3.0, 3.0, 3.0],
        ("c", "rbtm"): [1.0, nan, 1.0], ("c", "previous"): [2.0, 5.0, 2.0],
    }  # fmt: skip
    pooled = known.pooled("rbtm", "previous")
    assert pooled is not None
    # 4, 1 and 1/2: each data set's geometric mean; the draw that failed is in neither
    assert pooled.ratio == pytest.approx((4 * 1 * 0.5) ** (1 / 3))
    assert (pooled.by_construction, pooled.cells, pooled.n_places) == (1, 3, 3)
    assert pooled.places is not None and pooled.places[0] == pytest.approx(0.5)
    assert pooled.places[1] == pytest.approx(4.0)
    assert pooled.draws is None  # two draws of c are too few


def test_places_of_the_axes_are_no_data_sets(tmp_path: Path) -> None:
    """Twice as good at one place and four times worse at another: one data set's word."""
    ways = {n: SMALL["ways"][n] for n in ("previous", "rbtm")}  # type: ignore[index]
    data = {"a": "dataset.environment=paper"}
    axes = {"noise": {"key": "dataset.range_noise", "values": [0.0, 0.1, 0.2]}}
    study = study_file.load(changed(tmp_path, ways=ways, data=data, axes=axes), False, [])
    known = Known(Plan(study, {}, {}, {}), tmp_path)
    ours = {"0": [1.0, 2.0, 4.0], "0.1": [0.5, 1.0, 2.0], "0.2": [4.0, 8.0, 16.0]}
    for noise, errors in ours.items():
        known.errors = getattr(known, "errors", {}) | {
            (f"a noise={noise}", "rbtm"): errors,
            (f"a noise={noise}", "previous"): [1.0, 2.0, 4.0],
        }
    pooled = known.pooled("rbtm", "previous")
    assert pooled is not None and pooled.ratio == pytest.approx(2 ** (1 / 3))
    assert (pooled.n_places, pooled.cells, pooled.places) == (1, 3, None)
    # every draw says the same of the three places together, however they differ among themselves
    assert pooled.draws == pytest.approx((2 ** (1 / 3), 2 ** (1 / 3)))


def test_cells_are_the_settings_that_composing_them_gives(tmp_path: Path) -> None:
    axes = {"noise": {"key": "dataset.range_noise", "values": [0.0, 0.1]}}
    study = study_file.load(changed(tmp_path, axes=axes), False, [])
    plan = Plan.of(study)
    for label, _, _, words in study.cells():
        settings = plan.known[Method(label, "open3d_p2p", "previous"), 1]
        own = "registration.max_correspondence_distance=0.5 selector=previous backend=open3d_p2p"
        composed = compose_settings([*ALWAYS, *study.words, *words, *own.split()])
        assert settings.identity == composed.identity
        assert settings.config == composed.config


def test_an_unknown_study_says_which_is_close() -> None:
    with pytest.raises(ConfigError, match=r"study premis: no such study.*premise"):
        study_file.load("premis", False, [])
    assert json.dumps(study_file.names()).count("premise") == 1
