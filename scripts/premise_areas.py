"""How well each similarity tells success (rbtm_bench/studies/premise/areas.py)."""

import sys

from rbtm_bench.studies.premise.areas import main

if __name__ == "__main__":
    sys.exit(main())
