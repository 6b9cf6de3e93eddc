"""A process of ours: garbage is looked for again once it works, and its end loses nothing."""

from __future__ import annotations

import subprocess
import sys

import pytest

CODE = """
import atexit, gc, sys, threading, time
from rbtm_bench.core import process
process.begin()
assert not gc.isenabled()
process.settle()
assert gc.isenabled() and (frozen := gc.get_freeze_count()) > 0
process.settle()
assert gc.get_freeze_count() == frozen, "what a run leaves behind is garbage, too"


class Open:
    def __del__(self):
        print("taken apart")


def slow():
    time.sleep(0.2)
    print("thread")


kept = Open()
atexit.register(print, "exit function")
threading.Thread(target=slow).start()
if "strangers" in sys.argv:
    process.has_strangers()
process.end(3)
"""


@pytest.mark.parametrize("words, last", [((), []), (("strangers",), ["taken apart"])])
def test_threads_exit_functions_and_output_come_before_the_end(
    words: tuple[str, ...], last: list[str]
) -> None:
    done = subprocess.run([sys.executable, "-c", CODE, *words], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (3, "")
    assert done.stdout.splitlines() == ["thread", "exit function", *last]
