"""The main job on the embedded corridor (rbtm_bench/studies/demo.py)."""

import sys

from rbtm_bench.studies.demo import main

if __name__ == "__main__":
    sys.exit(main())
