"""``python -m rbtm_bench.contract``: the contract tests, wherever the package is installed."""

from __future__ import annotations

import sys


def main(words: list[str]) -> int:
    """Run the contract tests by pytest; ``words`` are its arguments and our own."""
    try:
        import pytest
    except ImportError:
        print("rbtm_bench.contract: the tests need pytest: pip install pytest", file=sys.stderr)
        return 2
    # dash comes with open3d; its plugin imports a web server
    ours = ["-p", "rbtm_bench.contract.plugin", "-p", "no:dash", "--pyargs", "rbtm_bench.contract"]
    return int(pytest.main([*ours, *words]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
