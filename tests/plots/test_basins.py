"""The basin of convergence: the benchmark end to end, and its figure."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from sweep_helpers import script

from rbtm_bench.plots import basins, style

SIZES = ("--metres", "0", "0.5", "--degrees", "0", "40", "--pairs", "3", "--gap", "2")


def test_basins_of_simulated_scans(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = script("bench_basin")
    monkeypatch.setattr(bench, "pin_to_free_core", lambda: None)
    words = ["--backends", "open3d_p2plane,hsm", *SIZES, "--out", str(tmp_path)]
    assert bench.main([*words, "dataset.scans=31"]) == 0
    with open(tmp_path / "basin.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(r["backend"], r["guess_off_m"], r["guess_off_deg"]) for r in rows] == [
        (name, m, d)
        for name in ("open3d_p2plane", "hsm")
        for m in ("0.0", "0.5")
        for d in ("0.0", "40.0")
    ]
    success = {
        (r["backend"], r["guess_off_m"], r["guess_off_deg"]): float(r["success"]) for r in rows
    }
    assert success["open3d_p2plane", "0.0", "0.0"] == 1.0  # from the truth, 0.12 m apart
    assert success["hsm", "0.5", "40.0"] == success["hsm", "0.0", "0.0"]  # it is global
    shown = capsys.readouterr().out
    assert "3 pairs, found: within 0.1 m and 2 deg of the truth" in shown
    assert str(tmp_path / "basin.png") in shown and (tmp_path / "basin.pdf").stat().st_size > 0


def test_a_panel_a_backend_in_percent() -> None:
    shares = {(0.0, 0.0): 1.0, (0.0, 10.0): 0.4, (0.5, 0.0): 0.75, (0.5, 10.0): 0.0}
    with style.paper():
        figure = basins.draw({"one": shares, "other": dict.fromkeys(shares, 1.0)}, "a title")
    panels = [ax for ax in figure.axes if ax.get_title()]
    assert [ax.get_title() for ax in panels] == ["one", "other"]
    (image,) = panels[0].images
    np.testing.assert_allclose(image.get_array(), [[100.0, 40.0], [75.0, 0.0]])
    assert [text.get_text() for text in panels[0].texts] == ["100", "40", "75", "0"]
    assert [text.get_color() for text in panels[0].texts] == ["black", "white", "black", "white"]
    assert [label.get_text() for label in panels[0].get_yticklabels()] == ["0", "0.5"]
