"""rbtm_bench: compare registration backends and model-scan selection strategies."""

__version__ = "0.1.0"
