"""Shell completion: what a shell gets for half a line."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rbtm_bench.cli.commands import main
from rbtm_bench.cli.completion import COMMANDS
from rbtm_bench.runs.settings import members


@pytest.fixture
def complete(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """A function: the words that complete a line, asked for in this process."""
    argv = list(sys.argv)

    def ask(line: str) -> list[str]:
        monkeypatch.setenv("COMP_LINE", line)
        monkeypatch.setenv("COMP_POINT", str(len(line)))
        capsys.readouterr()
        assert main(["-sc", "query=bash"]) == 0
        captured = capsys.readouterr()
        assert captured.err == ""
        return captured.out.split()

    yield ask
    sys.argv[:] = argv


def starting(prefix: str, group: str) -> list[str]:
    return [f"{group}={name}" for name in members(group) if name.startswith(prefix)]


def test_as_a_shell_asks(tmp_path: Path) -> None:
    line = "rbtm-bench run backend=o"
    done = subprocess.run(
        [sys.executable, "-m", "rbtm_bench", "-sc", "query=bash"],
        env={**os.environ, "COMP_LINE": line, "COMP_POINT": str(len(line))},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == starting("o", "backend")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["run", "compare", "sweep"])
def test_members_and_keys(complete, command: str) -> None:
    assert complete(f"rbtm-bench {command} backend=o") == starting("o", "backend")
    assert complete(f"rbtm-bench {command} selector=r") == starting("r", "selector")
    assert complete(f"rbtm-bench {command} selector.th") == ["selector.threshold="]
    assert complete(f"rbtm-bench {command} backend=none selector=fixed_gap selector.g") == [
        "selector.gap="
    ]
    assert complete(f"rbtm-bench {command} dataset=carmen dataset.p") == ["dataset.path="]
    assert {"backend=", "selector=", "seed=", "out="} <= set(complete(f"rbtm-bench {command} "))


def test_keys_after_lists_of_values(complete) -> None:
    line = "rbtm-bench compare backend=none,open3d_p2p selector=rbtm,previous selector.wi"
    assert complete(line) == ["selector.window=", "selector.window_m="]


def test_commands(complete) -> None:
    assert complete("rbtm-bench ") == list(COMMANDS)
    assert complete("rbtm-bench ta") == ["table"]
    assert complete("rbtm-bench x") == []


@pytest.mark.parametrize(
    "line",
    [
        "rbtm-bench table results/",
        "rbtm-bench plot ",
        "rbtm-bench nix backend=",
        "rbtm-bench",
        "",
        "rbtm-bench run dataset=[ selector.",
        "rbtm-bench run backend=nix selector.",
        "rbtm-bench compare backend=none --config-dir x backend=",
    ],
)
def test_nothing_to_say_is_no_noise(complete, line: str) -> None:
    assert complete(line) == []


def test_other_ways_to_call_it(complete) -> None:
    for program in (
        "/usr/local/bin/rbtm-bench",
        "python -m rbtm_bench",
        "python3.11 -m rbtm_bench",
    ):
        assert complete(f"{program} run selector=p") == starting("p", "selector")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_install_and_uninstall(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    for action in ("install", "uninstall"):
        assert main(["-sc", f"{action}={shell}"]) == 0
        assert "hydra" in capsys.readouterr().out
    assert main(["-sc", "install=cmd"]) != 0
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_bash_takes_it(tmp_path: Path) -> None:
    bash, script = shutil.which("bash"), Path(sys.executable).parent / "rbtm-bench"
    if bash is None or not script.exists():
        pytest.skip("needs bash and the console script")
    commands = """
eval "$(rbtm-bench -sc install=bash)"
COMP_WORDS=(rbtm-bench run backend=o); COMP_CWORD=2
COMP_LINE="${COMP_WORDS[*]}"; COMP_POINT=${#COMP_LINE}
hydra_bash_completion
echo "${COMPREPLY[*]}"
"""
    # Hydra's bash script splits the program's path at spaces: call it by one without
    (tmp_path / script.name).symlink_to(script)
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        [bash, "-c", commands],
        env={**os.environ, "PATH": path},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert "open3d_p2p" in done.stdout, done.stdout + done.stderr
