"""The command line, called by studies that are made of its commands."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence


def rbtm_bench(words: Sequence[str], quiet: bool = False) -> int:
    """The exit code of ``rbtm-bench WORDS``; ``quiet`` throws its standard output away."""
    output = subprocess.DEVNULL if quiet else None
    return subprocess.run([sys.executable, "-m", "rbtm_bench", *words], stdout=output).returncode
