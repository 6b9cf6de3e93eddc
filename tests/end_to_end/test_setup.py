"""The set-up files: scripts that parse, pins that are plain, no registry named anywhere."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

REPO = Path(__file__).resolve().parents[2]
SCRIPTS = [*sorted((REPO / "scripts").glob("*.sh")), REPO / ".ci" / "run"]
PIN = re.compile(r"([A-Za-z0-9][A-Za-z0-9._-]*)==[0-9][0-9A-Za-z.]*")
HOSTS = ("pypi_org", "python hosted_org", "test_pypi", "anaconda_org", "debian_org", "npmjs_org")
"""Registries, spelt with _ for the dot and blanks: no host's name stands in any file."""
SETTINGS = ("archive_ubuntu", "registry_npmjs", "index-url", "find-links")
REGISTRY = re.compile(
    "|".join((*HOSTS, *SETTINGS)).replace(" ", "").replace("_", r"\."), re.IGNORECASE
)


def canonical(name: str) -> str:
    """A distribution's name as package indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def pins() -> dict[str, str]:
    """Canonical name -> line of constraints.txt."""
    lines = (REPO / "constraints.txt").read_text("utf-8").splitlines()
    return {canonical(line.split("==")[0]): line for line in lines}


def test_constraints_are_names_and_numbers() -> None:
    lines = (REPO / "constraints.txt").read_text("utf-8").splitlines()
    assert [line for line in lines if not PIN.fullmatch(line)] == []
    assert len(pins()) == len(lines), "a name stands twice"


def test_every_direct_dependency_is_pinned() -> None:
    project = tomllib.loads((REPO / "pyproject.toml").read_text("utf-8"))["project"]
    wanted = project["dependencies"] + project["optional-dependencies"]["dev"]
    names = {canonical(re.split(r"[^A-Za-z0-9._-]", requirement)[0]) for requirement in wanted}
    assert names <= pins().keys()


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_scripts_parse_and_can_be_called(script: Path) -> None:
    assert os.access(script, os.X_OK)
    assert "set -euo pipefail" in script.read_text("utf-8")
    subprocess.run(["bash", "-n", str(script)], check=True)


def test_no_registry_is_named_in_a_committed_file() -> None:
    if not shutil.which("git") or not (REPO / ".git").exists():
        pytest.skip("not a git checkout")
    listed = subprocess.run(
        ["git", "-c", f"safe.directory={REPO}", "ls-files", "-z"],
        cwd=REPO,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    machinery = {"tests/end_to_end/test_setup.py", "scripts/setup.sh"}  # name pip's settings only
    named = []
    for name in filter(None, listed.split("\0")):
        try:
            text = (REPO / name).read_text("utf-8")
        except (UnicodeDecodeError, FileNotFoundError):
            continue  # binary, or deleted and not yet committed
        named += [f"{name}: {m}" for m in REGISTRY.findall(text) if name not in machinery]
    assert named == []


@pytest.mark.parametrize("name", ["pyproject.toml", "constraints.txt", "scripts/setup.sh"])
def test_set_up_names_no_address(name: str) -> None:
    assert not re.search(r"https?:|file:|git\+", (REPO / name).read_text("utf-8"))


def test_readme_and_ci_name_the_scripts() -> None:
    readme = (REPO / "README.md").read_text("utf-8")
    assert "scripts/demo.sh" in readme and "scripts/test.sh" in readme
    assert "scripts/test.sh" in (REPO / ".ci" / "run").read_text("utf-8")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder with a blank in its name that holds what setup.sh reads."""
    root = tmp_path / "a checkout"
    (root / "scripts").mkdir(parents=True)
    for name in ("pyproject.toml", "constraints.txt", "scripts/setup.sh"):
        shutil.copy(REPO / name, root / name)
    return root


def fake(folder: Path, name: str, body: str) -> None:
    """An executable shell script."""
    (folder / name).write_text(f"#!/bin/sh\n{body}\n")
    (folder / name).chmod(0o755)


def set_up(checkout: Path, *arguments: str, fakes: dict[str, str]) -> tuple[int, str]:
    """Exit code and words of setup.sh with stand-ins first on PATH, from another folder."""
    folder = checkout / "fakes"
    folder.mkdir(exist_ok=True)
    for name, body in fakes.items():
        fake(folder, name, body)
    done = subprocess.run(
        ["bash", str(checkout / "scripts" / "setup.sh"), *arguments],
        cwd="/",
        env={"PATH": f"{folder}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    return done.returncode, done.stderr


OLD = {f"python3{minor}": "exit 1" for minor in ("", ".11", ".12", ".13")}


def test_an_old_python_is_named(checkout: Path) -> None:
    code, words = set_up(checkout, fakes=OLD)
    assert code == 1
    assert "Python 3.11 or newer is needed" in words
    assert not (checkout / ".venv").exists()


def test_missing_libraries_are_named_to_a_user_who_may_not_install_them(checkout: Path) -> None:
    lacking = 'case $1 in -c) exit 0;; *) echo libgl1; echo "libusb-1.0-0";; esac'
    code, words = set_up(
        checkout,
        fakes={
            "python3.11": lacking,
            "id": "echo 1000",
            "sudo": "exit 1",
            "apt-get": "echo apt-get was called; exit 1",
        },
    )
    assert code == 1
    assert "these system packages are missing: libgl1 libusb-1.0-0" in words
    assert "sudo apt-get update && sudo apt-get install" in words
    assert "was called" not in words
    assert not (checkout / ".venv").exists()


def test_an_unknown_kind_is_refused(checkout: Path) -> None:
    code, words = set_up(checkout, "everything", fakes={})
    assert code == 1
    assert 'unknown kind "everything"' in words


def test_a_finished_set_up_is_left_alone_and_a_half_made_one_is_not(checkout: Path) -> None:
    """The stand-in Python runs no pip: only the decisions of setup.sh are looked at."""
    python = (
        'if [ "$1" = -m ] && [ "$2" = venv ]; then echo "venv was called" >&2; mkdir -p "$3/bin";'
        ' cp "$0" "$3/bin/python"; elif [ "$2" = pip ]; then echo "pip was called" >&2;'
        " echo no-index=1; fi"
    )
    (checkout / ".venv").mkdir()
    (checkout / ".venv" / "left over").touch()
    fakes = {"python3.11": python}
    code, words = set_up(checkout, "dev", fakes=fakes)
    assert code == 0, words
    assert "rebuilding .venv" in words and "venv was called" in words and "pip was called" in words
    assert not (checkout / ".venv" / "left over").exists()
    assert set_up(checkout, fakes=fakes) == (0, "")
    (checkout / "constraints.txt").write_text("numpy==2.0.0\n")
    code, words = set_up(checkout, fakes=fakes)
    assert code == 0, words
    assert "pip was called" in words and "venv was called" not in words
    (checkout / ".venv" / ".setup-done").unlink()
    code, words = set_up(checkout, fakes=fakes)
    assert code == 0, words
    assert "rebuilding .venv" in words and "venv was called" in words
