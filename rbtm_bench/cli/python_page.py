"""docs/python.md: the public face, out of its docstrings."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rbtm_bench
from rbtm_bench import api
from rbtm_bench.core.files import write_text
from rbtm_bench.odometry.result import Odometry

PAGE = Path(__file__).resolve().parents[2] / "docs" / "python.md"
SECTION = re.compile(r"^(\w+)\n-+$", re.MULTILINE)
FUNCTIONS = ("register", "odometry", "open_dataset", "run", "compare", "load_runs", "evaluate")
HEAD = """# rbtm_bench from Python

Made from the docstrings by `python scripts/make_python_page.py`;
[quickstart.ipynb](quickstart.ipynb) does it all once.

```python
import rbtm_bench as rb

# arrays (N, 2), (N, 3) or Open3D clouds
result = rb.register(source, target, backend="open3d_gicp")
print(result.T_target_source, result.fitness)

odometry = rb.odometry(scans, backend="plicp", selector="rbtm", selector__window=20)
odometry.trajectory.write_tum("trajectory.tum")
odometry.steps  # a DataFrame, a row a scan
```

The import loads nothing; a name loads what it needs when it is first used.

**Settings** are the command line's, as keyword arguments, with two underscores where it has a dot:
`selector.window=10` is `selector__window=10` (as in scikit-learn), or `**{"selector.window": 10}`.
A group by itself chooses a member: `similarity="overlap"`. In `compare` a list multiplies.
`rbtm-bench list` names them all; a wrong name is a `ConfigError` that says what was meant.

**Where it runs.** `register` and `odometry` work in your process, on all its cores. `run` and
`compare` make processes of their own, each pinned to a core: their numbers are those of the command
line, bit for bit, and their folders can be read, shown and resumed by it.
"""


CLASSES = "Data, and what plug-ins of your own derive from ([plug-ins](plugins.md))."


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    parts += [_part(name, getattr(rbtm_bench, name)) for name in FUNCTIONS[:2]]
    parts += [_part("Odometry", Odometry, of="what `odometry` returns")]
    parts += [_part(name, getattr(rbtm_bench, name)) for name in FUNCTIONS[2:]]
    classes = [name for name in rbtm_bench.__all__ if name not in FUNCTIONS]
    rows = [(name, getattr(rbtm_bench, name)) for name in classes]
    lines = [
        "## Classes",
        "",
        "Data, and what plug-ins of your own derive from ([plug-ins](plugins.md)).",
        "",
    ]
    lines += ["| name | is | to write |", "|---|---|---|"]
    lines += [f"| `{name}` | {_first_sentence(cls)} | {_to_write(cls)} |" for name, cls in rows]
    return "\n".join([*parts, "\n".join(lines)]) + "\n"


def _part(name: str, thing: Any, of: str = "") -> str:
    """A function's signature and docstring, or a class's docstring."""
    signature = "" if inspect.isclass(thing) else str(inspect.signature(_function(thing)))
    short = re.sub(r"(: |-> )'([^']*)'", r"\1\2", signature)  # annotations are text
    title = (
        f"## {name}\n"
        if not signature
        else f"## {name}\n\n```python\nrb.{name}{_folded(short)}\n```\n"
    )
    head, *sections = SECTION.split(inspect.getdoc(_function(thing)) or "")
    lines = [title, *([f"{of[:1].upper()}{of[1:]}.", ""] if of else []), _plain(head.strip())]
    for what, body in zip(sections[::2], sections[1::2], strict=True):
        lines += ["", f"**{what}**", "", *_entries(what, body.strip("\n"))]
    return "\n".join(lines) + "\n"


def _function(thing: Any) -> Any:
    """``odometry`` is the name of a room, too, which calls the function."""
    return api.odometry if inspect.ismodule(thing) else thing


def _folded(signature: str) -> str:
    """A signature, its parameters on lines of their own where it is long."""
    if len(signature) < 80:
        return signature
    inside, _, returns = signature[1:].rpartition(")")
    parts = re.split(r", (?=[\w*]+[:,=]|\*)", inside)
    return "(\n" + "".join(f"    {part},\n" for part in parts) + f"){returns}"


def _entries(section: str, body: str) -> list[str]:
    """The lines of a section: a bullet an entry, or its sentences."""
    if section == "Source":
        return [_plain(body)]
    entries: list[tuple[str, list[str]]] = []
    for line in body.splitlines():
        if line.startswith(" "):
            entries[-1][1].append(line.strip())
        elif line:
            name, _, kind = line.partition(" : ")
            entries.append((f"- `{name}`" + (f" ({kind})" if kind else ""), []))
    return [_plain(": ".join([head, *filter(None, [" ".join(text)])])) for head, text in entries]


def _plain(text: str) -> str:
    """reStructuredText's literals as Markdown's."""
    return text.replace("``", "`")


def _first_sentence(cls: type) -> str:
    doc = " ".join((inspect.getdoc(cls) or "").split())
    return _plain(re.split(r"(?<=[.:]) ", doc)[0].rstrip(":."))


def _to_write(cls: type) -> str:
    names = sorted(getattr(cls, "__abstractmethods__", ()))
    return ", ".join(f"`{name}`" for name in names)


def main(argv: Sequence[str] | None = None) -> int:
    """Write, or with ``--check`` say whether it is what would be written."""
    words = sys.argv[1:] if argv is None else list(argv)
    if words not in ([], ["--check"]):
        print(__doc__)
        return 2
    text = PAGE.read_text(encoding="utf-8") if PAGE.is_file() else ""
    if words:
        stale = page() != text
        print(f"{PAGE.name}: {'run scripts/make_python_page.py' if stale else 'up to date'}")
        return int(stale)
    write_text(PAGE, page())
    print(PAGE)
    return 0
