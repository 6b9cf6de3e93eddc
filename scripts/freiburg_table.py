"""Every planar backend and strategy on the Freiburg logs (rbtm_bench/studies/freiburg)."""

import sys

from rbtm_bench.studies.freiburg.command import main

if __name__ == "__main__":
    sys.exit(main())
