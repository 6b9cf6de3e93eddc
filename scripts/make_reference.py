"""The committed reference tables (rbtm_bench/studies/reference.py)."""

import sys

from rbtm_bench.studies.reference import main

if __name__ == "__main__":
    sys.exit(main())
