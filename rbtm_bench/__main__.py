"""``python -m rbtm_bench`` is ``rbtm-bench``."""

from rbtm_bench.cli import main

main()
