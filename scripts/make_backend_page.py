"""docs/backends.md out of the config group (rbtm_bench/cli/backend_page.py); --check compares."""

import sys

from rbtm_bench.cli.backend_page import main

if __name__ == "__main__":
    sys.exit(main())
