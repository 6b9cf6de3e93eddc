"""Somebody else's plug-in, made of just what docs/plugins.md says."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "plugins.md"

SELECTOR = """
from rbtm_bench.selection.base import Selector

class SecondNewest(Selector):
    def __init__(self, reach: int = 2):
        super().__init__(capacity=reach)

    def order(self, scan, models, scores):
        return [(0, "second newest")]
"""

SIMILARITY = """
import numpy as np
from rbtm_bench.similarity.base import Similarity

class MeanRange(Similarity):
    def describe(self, scan):
        ranges = np.linalg.norm(scan.points, axis=1)
        return np.array([ranges.mean() if len(ranges) else np.nan])

    def scores(self, window, descriptor):
        return np.exp(-np.abs(window[:, 0] - descriptor[0]))
"""


def block(language: str) -> str:
    """The page's one block in a language."""
    found = re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(found) == 1, f"docs/plugins.md has {len(found)} {language} blocks"
    return str(found[0])


def commands() -> list[str]:
    """The page's command lines."""
    return [
        line.strip()
        for line in PAGE.read_text().splitlines()
        if line.startswith("    ") and line.split()[0] in ("rbtm-bench", "pytest", "python")
    ]


def call(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run one of the page's commands in the author's folder."""
    words = shlex.split(command)
    modules = {"rbtm-bench": ["-m", "rbtm_bench"], "pytest": ["-m", "pytest"], "python": []}
    env = {key: value for key, value in os.environ.items() if key != "PYTEST_ADDOPTS"}
    return subprocess.run(
        [sys.executable, *modules[words[0]], *words[1:]],
        cwd=folder,
        env=env,
        capture_output=True,
        text=True,
        timeout=600,
    )


@pytest.fixture(scope="module")
def author(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An author's folder: the page's module and YAML, a selector and a similarity likewise."""
    folder = tmp_path_factory.mktemp("author")
    for group in ("backend", "selector", "similarity"):
        (folder / "my_configs" / group).mkdir(parents=True)
    (folder / "my_configs/my_icp.py").write_text(block("python"))
    (folder / "my_configs/backend/my_icp.yaml").write_text(block("yaml"))
    (folder / "my_configs/my_selector.py").write_text(SELECTOR)
    (folder / "my_configs/selector/second.yaml").write_text(
        "_target_: my_selector.SecondNewest\nreach: 2\n"
    )
    (folder / "my_configs/my_similarity.py").write_text(SIMILARITY)
    (folder / "my_configs/similarity/mean_range.yaml").write_text(
        "_target_: my_similarity.MeanRange\n"
    )
    return folder


def test_page_is_short() -> None:
    assert len(PAGE.read_text().splitlines()) < 40


def test_page_names_list_compare_and_contract() -> None:
    text = " ".join(commands())
    assert "list" in text and "compare" in text and "contract" in text


@pytest.mark.slow
@pytest.mark.parametrize("command", commands())
def test_every_command_of_the_page(author: Path, command: str) -> None:
    done = call(command, author)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert "my_icp" in done.stdout or "passed" in done.stdout


def test_run_with_all_three(author: Path) -> None:
    words = "backend=my_icp selector=second similarity=mean_range dataset.scans=12 out=r1"
    done = call(f"rbtm-bench run {words} --config-dir my_configs", author)
    assert done.returncode == 0, done.stderr
    assert "my_icp, second" in done.stdout


def test_similarity_of_somebody_else_feeds_rbtm(author: Path) -> None:
    words = "similarity=mean_range selector=rbtm dataset.scans=12 out=r2"
    done = call(f"rbtm-bench run {words} --config-dir my_configs", author)
    assert done.returncode == 0, done.stderr


def test_wrong_setting_of_a_foreign_plugin(author: Path) -> None:
    done = call("rbtm-bench run backend=my_icp backend.rounds=many --config-dir my_configs", author)
    assert done.returncode == 2
    assert "backend.rounds=many" in done.stderr


def test_contract_of_selector_and_similarity(author: Path) -> None:
    contract = next(c for c in commands() if "contract" in c)
    for plugin in ("selector=second", "similarity=mean_range"):
        done = call(contract.replace("backend=my_icp", plugin), author)
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-2000:]
