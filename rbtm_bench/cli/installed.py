"""Which plug-ins can be used here: what studies of "every backend" go through."""

from __future__ import annotations

from functools import cache

from rbtm_bench.cli.about import missing_library
from rbtm_bench.runs.plugins import is_system, locate
from rbtm_bench.runs.settings import member_nodes


@cache
def planar_backends(first: str = "") -> tuple[str, ...]:
    """The names of every installed backend that registers pairs of planar scans, sorted; the one
    named ``first``, if it is there, before all others. Systems and "none" are not among them."""
    found = []
    for name, node in member_nodes("backend").items():
        if name == "none" or missing_library("backend", name, node) or not isinstance(node, dict):
            continue
        made = locate(f"backend={name}", str(node["_target_"]))
        if "2d" in getattr(made, "dimensions", ()) and not is_system({"backend": node}):
            found.append(name)
    return tuple(sorted(found, key=lambda name: (name != first, name)))
