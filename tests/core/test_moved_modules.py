"""Plug-ins that name modules of version 0.1 go on working, and are told the new names."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

import rbtm_bench


@pytest.mark.parametrize("old", rbtm_bench.MOVED)
def test_an_old_name_is_the_same_module(old: str) -> None:
    code = (
        "import importlib, warnings, sys\n"
        "with warnings.catch_warnings(record=True) as caught:\n"
        "    warnings.simplefilter('always')\n"
        f"    old = importlib.import_module({old!r})\n"
        f"new = importlib.import_module({rbtm_bench.MOVED[old]!r})\n"
        f"assert old is new and new.__spec__.name == {rbtm_bench.MOVED[old]!r}\n"
        f"assert [str(w.message) for w in caught] == ['{old} is now {rbtm_bench.MOVED[old]}']\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_targets_are_where_they_were() -> None:
    package = importlib.import_module("rbtm_bench.target")
    assert {"Target", "SingleScan", "LocalMap"} <= set(vars(package))
