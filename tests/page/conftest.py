"""A small comparison that the tests of the page share."""

from __future__ import annotations

import json
import re
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from sweep_helpers import call

from rbtm_bench.core.files import write_json
from rbtm_bench.page import assemble

ALL = (
    *("dataset.scans=24", "dataset.beams=181", "dataset.path_length=0.9"),
    *("check=gated", "check.max_translation=0.004", "pin=false"),
)
HOSTILE = "<script>alert(1)</script>"


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten runs in a corridor, some of whose registrations are refused, and one that failed, with
    markup for a name and a reason."""
    folder = tmp_path_factory.mktemp("page") / "results"
    settings = product((4, 8), (0.5, 0.95))
    ways = [
        ("previous",),
        *(("rbtm", f"selector.window={w}", f"selector.threshold={t}") for w, t in settings),
    ]
    for backend, (selector, *words) in product(("none", "plicp"), ways):
        name = "-".join([backend, selector, *words])
        words += [f"backend={backend}", f"selector={selector}", f"out='{folder / name}'"]
        code, _, error = call("run", *ALL, *words)
        assert code == 0, error
    failed = folder / "<script>alert(1)<&"
    failed.mkdir()
    (failed / "config.yaml").write_text((folder / "none-previous/config.yaml").read_text("utf-8"))
    record = json.loads((folder / "none-previous/run.json").read_text("utf-8"))
    record |= {"status": "failed", "reason": f"no {HOSTILE} & \u2028 more"}
    record["choices"] |= {"backend": HOSTILE}
    write_json(failed / "run.json", record)
    return folder


def payload(html: str) -> dict[str, Any]:
    """What a page's scripts are given."""
    found = re.search(r'<script id="data-of-page" type="application/json">(.*?)</script>', html)
    assert found is not None
    value: dict[str, Any] = json.loads(found.group(1))
    return value


@pytest.fixture(scope="session")
def html(results: Path) -> str:
    text, _ = assemble.page([results])
    return text


@pytest.fixture(scope="session")
def data(html: str) -> dict[str, Any]:
    return payload(html)
