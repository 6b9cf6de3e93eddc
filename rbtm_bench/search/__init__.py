"""Where a local registration starts: what is looked for around the guess before it."""

from rbtm_bench.search.base import Search, Start
from rbtm_bench.search.correlative import CorrelativeSearch
from rbtm_bench.search.none import NoSearch

__all__ = ["CorrelativeSearch", "NoSearch", "Search", "Start"]
