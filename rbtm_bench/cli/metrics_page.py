"""The tables of docs/metrics.md, from ``core.columns`` and ``core.step_columns``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from rbtm_bench.core.column import page_rows
from rbtm_bench.core.columns import COLUMNS, KNOWN
from rbtm_bench.core.files import write_text
from rbtm_bench.core.step_columns import STEPS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "metrics.md"
HEAD = "| key | unit | definition | source |"
STEP_HEAD = "| column | type | unit | definition |"


def page(text: str) -> str:
    """The page with its tables anew: a table keeps its first key's family, in declared order."""
    lines, rows = text.splitlines(), iter(text.splitlines())
    lines = []
    for line in rows:
        lines.append(line)
        if line not in (HEAD, STEP_HEAD):
            continue
        lines.append(next(rows))
        old = []
        for row in rows:
            if not row.startswith("|"):
                break
            old.append(row)
        lines += step_rows() if line == STEP_HEAD else _rows(old)
        lines.append(row)
    return "\n".join(lines) + "\n"


def _rows(old: Sequence[str]) -> list[str]:
    """The rows of the family of a table, of its references if those are what it holds."""
    first = KNOWN[old[0].split("`")[1]]
    derived = first.source == "as above"
    family = [c for c in COLUMNS if c.family == first.family]
    if first.family == "maps":
        family = [c for c in family if (c.source == "as above") is derived]
    return page_rows(family)


def step_rows() -> list[str]:
    """The rows of the table of steps.parquet."""
    return [f"| `{c.name}` | {c.type} | {c.unit} | {c.about} |" for c in STEPS]


def main(argv: Sequence[str] | None = None) -> int:
    """Write, or with ``--check`` say whether it is what would be written."""
    words = sys.argv[1:] if argv is None else list(argv)
    if words not in ([], ["--check"]):
        print(__doc__)
        return 2
    text = PAGE.read_text(encoding="utf-8")
    anew = page(text)
    if words:
        print(
            f"{PAGE.name}: {'up to date' if anew == text else 'run scripts/make_metrics_page.py'}"
        )
        return int(anew != text)
    write_text(PAGE, anew)
    print(PAGE)
    return 0
