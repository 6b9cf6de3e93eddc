"""Every reader on damaged files: refused in one line, or read with every point accounted for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reader_mutants import FORMATS, mutated, outcome

FEW, MANY = 20, 200


def results(name: str, folder: Path, count: int) -> dict[str, str]:
    form = FORMATS[name]
    (folder / "good").mkdir()
    content = form.write(folder / "good").read_bytes()
    assert outcome(form, folder / "again", content) == "read"
    found = {}
    for seed in range(count):
        kind, damaged = mutated(content, np.random.default_rng(seed))
        found[f"{kind} {seed}"] = outcome(form, folder / "bad", damaged)
    return found


@pytest.mark.parametrize("name", FORMATS)
def test_damage_is_refused_or_accounted_for(name: str, tmp_path: Path) -> None:
    found = results(name, tmp_path, FEW)
    wrong = {k: v for k, v in found.items() if v not in ("read", "refused")}
    assert not wrong


@pytest.mark.soak
@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_much_damage_is_refused_or_accounted_for(name: str, tmp_path: Path) -> None:
    found = results(name, tmp_path, MANY)
    wrong = {k: v for k, v in found.items() if v not in ("read", "refused")}
    assert not wrong
