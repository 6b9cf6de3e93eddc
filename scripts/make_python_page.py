"""docs/python.md out of the docstrings of the public face; --check compares."""

import sys

from rbtm_bench.cli.python_page import main

if __name__ == "__main__":
    sys.exit(main())
