"""A pivot as LaTeX, HTML and Markdown, each of which stands alone in a document."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

from rbtm_bench.core import escape
from rbtm_bench.report import better, pivot
from rbtm_bench.report.best_settings import listed
from rbtm_bench.report.margin import Margin
from rbtm_bench.report.names import in_sentence
from rbtm_bench.report.pivot import Block, PaperCell, Pivot

FORMATS = ("latex", "html", "md")
PACKAGES = "% needs \\usepackage{booktabs} and \\usepackage{siunitx}"
DIGITS = 3
"""Significant digits."""
COLUMN = 58
"""Letters that fit a column of a two-column page; wider tables go over both."""
NARROW = 8
"""Letters of a header that stay on one line."""
TIED, DEAD = "\N{DAGGER}", "\N{DOUBLE DAGGER}"
FAILED, ABSENT = "failed", "\N{EN DASH}"


def number(value: float) -> str:
    """Three significant digits, trailing zeros too: "3.65", "39.0", "1710"."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    power = math.floor(math.log10(abs(float(f"{value:.{DIGITS - 1}e}"))))
    return f"{value:.{max(DIGITS - 1 - power, 0)}f}" if power >= -4 else f"{value:.2e}"


def typeset(table: Pivot, fmt: str, spread: bool = True) -> str:
    """The table in one of ``FORMATS``; ``spread``: with quartiles, where there are replicates."""
    layout = _layout(table, spread)
    return {"latex": _latex, "html": _html, "md": _markdown}[fmt](layout)


@dataclass(frozen=True, eq=False)
class Entry:
    """A cell to be written: its number or word, quartiles and marks."""

    text: str
    quartiles: str = ""
    best: bool = False
    marks: str = ""


@dataclass(frozen=True, eq=False)
class Layout:
    """What all formats write: plain text everywhere. ``over`` stands above all columns; every
    block has a heading ("" of a single one) and lines of a name and entries."""

    corner: str
    over: str
    columns: list[str]
    blocks: list[tuple[str, list[tuple[str, list[Entry]]]]]
    caption: str
    label: str


def _layout(table: Pivot, spread: bool) -> Layout:
    names, keys = table.names, table.keys
    on_axis = pivot.METRIC in (table.rows, table.columns)
    columns = table.values(table.columns)
    blocks = []
    for block in table.blocks:
        heading = block.data if len(table.blocks) > 1 else ""
        if len(keys) > 1 and not on_axis:
            heading += f": {names.titled(block.keys[0])}"
        lines = []
        for row in table.values(table.rows, block):
            cells = [block.cells.get((row, column)) for column in columns]
            lines.append((table.words(table.rows, row), [_entry(cell, spread) for cell in cells]))
        blocks.append((heading, lines))
    over = names.titled(keys[0]) if len(keys) == 1 and not on_axis else ""
    words = [table.words(table.columns, column) for column in columns]
    label = "-".join(["tab:" + keys[0].replace("_", "-"), table.rows, table.columns])
    return Layout(names.of("axis", table.rows), over, words, blocks, caption(table, spread), label)


def _entry(cell: PaperCell | None, spread: bool) -> Entry:
    if cell is None:
        return Entry(ABSENT)
    marks = TIED * cell.tied + DEAD * cell.dead
    if cell.value is None:
        return Entry(FAILED, marks=marks)
    ends = cell.quartiles if spread else None
    words = f"[{number(ends[0])}, {number(ends[1])}]" if ends else ""
    return Entry(number(cell.value), words, cell.best, marks)


# --- what a reader has to know


def caption(table: Pivot, spread: bool) -> str:
    """Data, replicates, choice of settings, marks and test, in sentences."""
    names, keys, cells = table.names, table.keys, table.cells
    what = listed([names.metric(keys[0]), *(in_sentence(names.metric(key)) for key in keys[1:])])
    data = pivot.DATA in (table.rows, table.columns)
    where = "" if data else f" on {listed([block.data for block in table.blocks])}"
    unit, fewest, most = pivot.repeats(cells)
    many = str(most) if fewest == most else f"{fewest} to {most}"
    words = [f"{what}{where}"]
    if most > 1:
        copies = "perturbed copies of the data" if unit == "replicates" else f"{unit}"
        words[0] += f": median over {many} {copies}"
        if spread and any(cell.quartiles for cell in cells):
            words[0] += " [quartiles]"
    elif fewest == most:
        words[0] += ": one run each"
    words += _of_settings(table)
    if any(cell.best for cell in cells):
        words.append(_of_marks(table.blocks, cells))
        if any(c.method.row["backend"] == pivot.NOTHING for c in cells) and TIED in words[-1]:
            words[-1] += f"; {in_sentence(names.of('backend', pivot.NOTHING))} is not tested"
    if any(cell.dead for cell in cells):
        words.append(f"{DEAD}: a run registered less than half of its scans")
    return ". ".join(words) + "."


def _of_settings(table: Pivot) -> list[str]:
    chosen = [cell for cell in table.cells if cell.settings > 1]
    elsewhere = any("chosen_on" in cell.method.row for cell in table.cells)
    out = ["Settings were chosen on other data"] if elsewhere else []
    if chosen:
        fewest, most = min(c.settings for c in chosen), max(c.settings for c in chosen)
        many = f"{most}" if fewest == most else f"{fewest} to {most}"
        every = len(chosen) == len(table.cells)
        which = "every cell" if every else f"{len(chosen)} of {len(table.cells)} cells"
        members = {"backend", "selector"} <= {table.rows, table.columns}
        kind = "settings" if members else "methods"
        text = f"In {which} the best of {many} {kind} on these data"
        by = f", by {in_sentence(table.names.metric(table.keys[0]))}" if len(table.keys) > 1 else ""
        out.append(text + by * (pivot.METRIC in (table.rows, table.columns)))
    return out


def _of_marks(blocks: Sequence[Block], cells: Sequence[PaperCell]) -> str:
    """What bold and the dagger mean, with the test."""
    lowest = "Bold: lowest" + (" of its data" if len(blocks) > 1 else "")
    comparisons = [one for block in blocks for one in block.comparisons]
    if not comparisons:
        return f"{lowest}; without replicates no difference is tested"
    tests = sorted({one.tests for one in comparisons})
    count = " and ".join(map(str, tests))
    unit = comparisons[0].unit
    rule = f"exact paired test over {unit}, Holm over {count} comparisons, p < {better.SIGNIFICANT}"
    margins = {one.margin for one in comparisons if one.unit == better.REPLICATES}
    if margins:
        rule += f", and medians more than {_factors(margins)} times apart"
    few = better.too_few(comparisons)
    rule += f"; {few}" if few else ""
    mark = f"{TIED}: not told apart from it" if any(c.tied for c in cells) else "all others differ"
    return f"{lowest}; {mark} ({rule})"


def _factors(margins: set[Margin]) -> str:
    return " and ".join(f"{factor:.3g}" for factor in sorted({m.factor for m in margins}))


# --- formats


def _latex(layout: Layout) -> str:
    count = len(layout.columns)
    longest = max(len(name) for _, lines in layout.blocks for name, _ in [*lines, ("", [])])
    longest = max(longest, len(layout.corner))
    wide = longest + sum(_letters(layout, i) + 2 for i in range(count)) > COLUMN
    star = "*" if wide else ""
    heads = [_head(column) for column in layout.columns]
    formats = [f"S[table-format={_format(layout, i)}]" for i in range(count)]
    lines = [
        PACKAGES, f"\\begin{{table{star}}}[t]", "\\centering",
        f"\\caption{{{escape.latex(layout.caption)}}}", f"\\label{{{layout.label}}}",
        "\\sisetup{detect-weight=true,mode=text,table-align-text-post=false}",
        "\\footnotesize", "\\setlength{\\tabcolsep}{3pt}",
        f"\\begin{{tabular}}{{@{{}}l{''.join(formats)}@{{}}}}",
        "\\toprule",
    ]  # fmt: skip
    if layout.over and count > 1:
        lines.append(f" & \\multicolumn{{{count}}}{{c}}{{{escape.latex(layout.over)}}} \\\\")
        lines.append(f"\\cmidrule(l){{2-{count + 1}}}")
    lines.append(" & ".join([escape.latex(layout.corner), *heads]) + " \\\\")
    for heading, rows in layout.blocks:
        lines.append("\\midrule")
        if heading:
            words = f"\\emph{{{escape.latex(heading)}}}"
            lines.append(f"\\multicolumn{{{count + 1}}}{{@{{}}l}}{{{words}}} \\\\")
        for place, (name, entries) in enumerate(rows):
            if place and any(entry.quartiles for entry in entries):
                lines.append("\\addlinespace[1.5pt]")
            lines.append(" & ".join([escape.latex(name), *map(_latex_entry, entries)]) + " \\\\")
            if any(entry.quartiles for entry in entries):
                small = [f"{{\\scriptsize {e.quartiles}}}" if e.quartiles else "" for e in entries]
                lines.append(" & ".join(["", *small]) + " \\\\")
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}", f"\\end{{table{star}}}"])


def _head(column: str) -> str:
    """A header, of several words over several lines."""
    words = escape.latex(column).split(" ")
    if len(column) <= NARROW or len(words) == 1:
        return f"{{{escape.latex(column)}}}"
    stacked = "\\\\".join(words)
    return f"{{\\shortstack{{{stacked}}}}}"


def _letters(layout: Layout, column: int) -> float:
    """The width of a column, in letters: quartiles are small."""
    entries = [entries[column] for _, rows in layout.blocks for _, entries in rows]
    head = layout.columns[column]
    parts = [head] if len(head) <= NARROW else head.split(" ")
    words = [*map(len, parts), *(len(e.text) + len(e.marks) for e in entries)]
    return max([*words, *(0.6 * len(e.quartiles) for e in entries)])


def _format(layout: Layout, column: int) -> str:
    """Digits before and after the point that a column needs."""
    entries = [entries[column] for _, rows in layout.blocks for _, entries in rows]
    numbers = [e.text for e in entries if e.text[-1].isdigit() and "e" not in e.text]
    before = max((len(n.partition(".")[0]) for n in numbers), default=1)
    after = max((len(n.partition(".")[2]) for n in numbers), default=0)
    return f"{before}.{after}"


def _latex_entry(entry: Entry) -> str:
    marks = entry.marks.replace(TIED, "\\dag").replace(DEAD, "\\ddag")
    marks = f"\\rlap{{\\textsuperscript{{{marks}}}}}" if marks else ""
    if not entry.text[-1].isdigit():
        return f"{{{'--' if entry.text == ABSENT else entry.text}{marks}}}"
    if "e" in entry.text:
        return f"{{\\num{{{entry.text}}}{marks}}}"
    return ("\\bfseries " if entry.best else "") + entry.text + marks


def _html(layout: Layout) -> str:
    cells = "".join(f"<th>{html.escape(column)}</th>" for column in layout.columns)
    lines = [
        "<table>", f"<caption>{html.escape(layout.caption)}</caption>", "<thead>",
        *([f'<tr><th></th><th colspan="{len(layout.columns)}">{html.escape(layout.over)}</th></tr>']
          if layout.over else []),
        f"<tr><th>{html.escape(layout.corner)}</th>{cells}</tr>", "</thead>", "<tbody>",
    ]  # fmt: skip
    for heading, rows in layout.blocks:
        if heading:
            span = len(layout.columns) + 1
            lines.append(f'<tr><th colspan="{span}">{html.escape(heading)}</th></tr>')
        for name, entries in rows:
            written = "".join(f"<td>{_html_entry(entry)}</td>" for entry in entries)
            lines.append(f"<tr><th>{html.escape(name)}</th>{written}</tr>")
    return "\n".join([*lines, "</tbody>", "</table>"])


def _html_entry(entry: Entry) -> str:
    text = f"<strong>{entry.text}</strong>" if entry.best else entry.text
    text += f"<sup>{entry.marks}</sup>" if entry.marks else ""
    return f"{text} <small>{entry.quartiles}</small>" if entry.quartiles else text


def _markdown(layout: Layout) -> str:
    lines: list[list[str]] = []
    for heading, rows in layout.blocks:
        if heading:
            lines.append([f"*{escape.markdown(heading)}*", *[""] * len(layout.columns)])
        for name, entries in rows:
            lines.append([escape.markdown(name), *map(_markdown_entry, entries)])
    head = [escape.markdown(word) for word in [layout.corner, *layout.columns]]
    rule = ["---", *["---:"] * len(layout.columns)]
    title = [f"**{escape.markdown(layout.over)}**", ""] if layout.over else []
    table = [f"| {' | '.join(cells)} |" for cells in [head, rule, *lines]]
    return "\n".join([*title, *table, "", escape.markdown(layout.caption)])


def _markdown_entry(entry: Entry) -> str:
    text = f"**{entry.text}**" if entry.best else entry.text
    return f"{text}{entry.marks} {entry.quartiles}".rstrip()
