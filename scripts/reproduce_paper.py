"""The paper's experiment from scratch (rbtm_bench/studies/paper)."""

import sys

from rbtm_bench.studies.paper.command import main

if __name__ == "__main__":
    sys.exit(main())
