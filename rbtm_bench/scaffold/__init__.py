"""Plug-ins that work as they are and are there to be changed: ``rbtm-bench new`` copies them."""
