"""What similarity adds to a larger gap (rbtm_bench/studies/premise)."""

import sys

from rbtm_bench.studies.premise.command import main

if __name__ == "__main__":
    sys.exit(main())
