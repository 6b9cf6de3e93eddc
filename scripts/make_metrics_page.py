"""The tables of docs/metrics.md out of the declared columns; --check compares."""

import sys

from rbtm_bench.cli.metrics_page import main

if __name__ == "__main__":
    sys.exit(main())
