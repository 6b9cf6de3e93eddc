"""``python -m rbtm_bench`` is ``rbtm-bench``."""

import sys

from rbtm_bench.cli.commands import main

sys.exit(main())
