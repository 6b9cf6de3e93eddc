"""Text of others stays text: in a terminal, a spreadsheet, Markdown and LaTeX."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pandas as pd
import pytest
from stat_helpers import MM, make_run

from rbtm_bench.cli.commands import main
from rbtm_bench.core import escape
from rbtm_bench.report import render

TITLE = "\x1b]0;owned\x07\x1b[2J\x9b31mred\u202egpj.exe"
"""Sets a window's title, clears the screen, colours by a C1 control, turns the writing."""


def test_no_control_reaches_a_terminal_but_tab_and_newline() -> None:
    every = "".join(map(chr, range(0xA0)))
    shown = escape.terminal(every)
    assert [c for c in shown if not c.isprintable()] == ["\t", "\n"]
    assert "\\x1b" in shown and "\\x9b" in shown
    assert escape.terminal("Grüße, 3 × ½ µm: 三") == "Grüße, 3 × ½ µm: 三"
    assert "\u202e" not in escape.terminal(TITLE)


@pytest.mark.parametrize("command", ["table", "show", "nothing"])
def test_a_command_writes_no_control_of_a_run_s_name_or_reason(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / f"run{TITLE.replace('/', '')}"
    make_run(run, "rbtm", None, told={"reason": f"lid {TITLE}", "command": f"x {TITLE}"})
    make_run(tmp_path / "b", "previous", {MM: 5.0})
    words = {"table": ["table", str(tmp_path)], "show": ["show", str(run)]}
    main(words.get(command, [TITLE]))
    told = capsys.readouterr()
    both = told.out + told.err
    assert both and not set(both) & {"\x1b", "\x9b", "\x07", "\u202e"}
    assert "owned" in both


def test_streams_are_as_they_were_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.StringIO()
    monkeypatch.setattr(sys, "stdout", out)
    with escape.harmless_output():
        with escape.harmless_output():  # not escaped twice
            print("a\x1b\\", end="")
        assert isinstance(sys.stdout, escape.Terminal)
    assert sys.stdout is out and out.getvalue() == "a\\x1b\\"


def test_formulas_in_cells_of_text_are_text_and_numbers_stay() -> None:
    table = pd.DataFrame({
        "run": ["=cmd|' /C calc'!A0", "+1", "-2", "@SUM(A1)", "\tx", "\rx", "fine"],
        "error": [-1.5, 2.0, -3.0, 0.0, 1.0, 1.0, 1.0],
    })  # fmt: skip
    lines = render.render(table, "csv").replace("\r", "<CR>").splitlines()
    cells = [line.strip('"').partition(",")[0].strip('"') for line in lines[1:]]
    assert [cell[0] for cell in cells] == ["'"] * 6 + ["f"]
    assert "-1.5" in lines[1] and "'-1.5" not in lines[1]


def test_markdown_and_latex_keep_text_text() -> None:
    table = pd.DataFrame({"run": ["<img src=x onerror=alert(1)> | a&b\nc"], "error": [1.0]})
    (row,) = render.render(table, "md").splitlines()[2:]
    assert "&lt;img src=x onerror=alert(1)&gt; \\| a&amp;b c" in row and "<" not in row
    assert (
        escape.latex("a_b\\input{x}%\x1b")
        == "a\\_b\\textbackslash{}input\\{x\\}\\%\\textbackslash{}x1b"
    )
