"""Choose the demo's settings on seeds that the demo does not show.

Every strategy gets the same four tries on the corridor with seeds 100 to 104. The try with the
smallest error (geometric mean over the four backends of the median over seeds) is the one that
scripts/demo.py uses.

    python scripts/choose_demo_settings.py
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from rbtm_bench.report import frame
from rbtm_bench.runs import stored
from rbtm_bench.studies.own_command import rbtm_bench

BACKENDS = "open3d_p2p,open3d_p2plane,open3d_gicp,kiss_icp"
SEEDS = "100,101,102,103,104"
TRIES = {
    "keyframe": ["selector.distance=0.1,0.2,0.3,0.5"],
    "fixed_gap": ["selector.gap=5,10,20,40"],
    "oldest": ["selector.window=8,16,32,64"],
    "rbtm": ["selector.window=64", "selector.threshold=0.5,0.6,0.7,0.8"],
}
ERROR = "final_translation_error_mm"


def choose(out: Path) -> int:
    """Run the tries and print the best of each strategy."""
    for selector, words in TRIES.items():
        grid = [f"backend={BACKENDS}", f"selector={selector}", *words, f"seed={SEEDS}"]
        grid.append("controls=none")
        code = rbtm_bench(["compare", *grid, f"out={out / selector}", "overwrite=true"])
        if code:
            return code
    print("\ngeometric mean over backends of the median final error over seeds (mm):")
    for selector in TRIES:
        table = frame.over_seeds(stored.find_runs([out / selector]))
        shown = table[["window", "threshold", "settings"]].astype(object)
        setting = shown.where(shown.notna(), "").map(str).agg(" ".join, axis=1)
        score = table.groupby(setting, sort=False)[ERROR].agg(lambda e: np.exp(np.log(e).mean()))
        for words, value in score.items():
            mark = "  <- chosen" if value == score.min() else ""
            print(f"  {selector:<10} {str(words).strip():<34} {value:8.2f}{mark}")
    return 0


def main() -> int:
    """The choice, into the folder named on the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, nargs="?", default=Path("results/demo_settings"))
    return choose(parser.parse_args().out)
