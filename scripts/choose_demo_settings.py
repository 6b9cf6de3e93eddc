"""The demo's settings, chosen on other seeds (rbtm_bench/studies/demo_settings.py)."""

import sys

from rbtm_bench.studies.demo_settings import main

if __name__ == "__main__":
    sys.exit(main())
