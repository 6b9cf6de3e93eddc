"""RBTM whose registrations are believed only after a check, the fallback's included.

Its config brings ``check=consistent`` along: ``selector=rbtm_verified`` is all one has to say.
"""

from __future__ import annotations

from rbtm_bench.selection.rbtm import Rbtm


class RbtmVerified(Rbtm):
    """RBTM's candidates in RBTM's order; the first whose registration passes the check is taken.

    The order is ``Rbtm``'s to the letter; what differs is that a check which accepts everything is
    refused. "Similar is not matched": a wrong alignment of similar scans is the way in which a
    large window fails.
    """

    needs_check = True
