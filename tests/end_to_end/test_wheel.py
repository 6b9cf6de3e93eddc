"""The distributions: what the wheel holds, and that it works away from the repository."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("build")
pytest.importorskip("hatchling")

pytestmark = pytest.mark.slow

REPO = Path(__file__).resolve().parents[2]


def run(*command: object, cwd: Path) -> str:
    """Standard output of a command that must succeed, away from any PYTHONPATH."""
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def build(source: Path, out: Path, *options: str) -> None:
    """Build with the tools of this environment: no network."""
    run(sys.executable, "-m", "build", "--no-isolation", *options, "-o", out, source, cwd=out)


def only(folder: Path, pattern: str) -> Path:
    """The one file of that pattern."""
    (path,) = folder.glob(pattern)
    return path


def members(wheel: Path) -> set[str]:
    """The names of the files in a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built straight from the repository."""
    out = tmp_path_factory.mktemp("wheel")
    build(REPO, out, "--wheel")
    return only(out, "*.whl")


def test_configs_travel_inside_the_package(wheel: Path) -> None:
    names = members(wheel)
    top = {name.split("/")[0] for name in names}
    (metadata,) = (name for name in top if name.endswith(".dist-info"))
    assert top == {"rbtm_bench", metadata}
    configs = {path.relative_to(REPO) for path in (REPO / "configs").rglob("*.yaml")}
    assert Path("configs/config.yaml") in configs
    assert {f"rbtm_bench/{path.as_posix()}" for path in configs} <= names
    page = {f"rbtm_bench/page/{path.name}" for path in (REPO / "rbtm_bench/page").glob("*.*")}
    assert "rbtm_bench/page/page.html" in page and page <= names


def test_wheel_from_the_sdist_is_the_same(wheel: Path, tmp_path: Path) -> None:
    build(REPO, tmp_path, "--sdist")
    with tarfile.open(only(tmp_path, "*.tar.gz")) as archive:
        archive.extractall(tmp_path)  # our own; `filter` is not in every 3.11
    build(only(tmp_path, "rbtm_bench-*/"), tmp_path, "--wheel")
    assert members(only(tmp_path, "*.whl")) == members(wheel)


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scripts folder of a new environment with the wheel and, by path, our dependencies.

    A path in a .pth file is searched but its own .pth files are not read, so an editable
    installation in this environment stays out of sight there.
    """
    home = tmp_path_factory.mktemp("environment")
    venv.create(home, symlinks=True)
    python = home / "bin" / "python"
    pip = (sys.executable, "-m", "pip", "--python", python)
    run(*pip, "install", "-q", "--no-deps", "--no-index", wheel, cwd=home)
    site_packages = run(
        python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=home
    ).strip()
    ours = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (Path(site_packages) / "dependencies.pth").write_text("\n".join(sorted(ours)) + "\n")
    return home / "bin"


def test_nothing_comes_from_the_repository(installed: Path, tmp_path: Path) -> None:
    code = (
        "import importlib.util, json, sys, numpy, rbtm_bench;"
        "print(json.dumps([rbtm_bench.__file__, sys.path, importlib.util.find_spec('configs')]))"
    )
    file, path, configs = json.loads(run(installed / "python", "-c", code, cwd=tmp_path))
    assert Path(file).is_relative_to(installed.parent)
    assert str(REPO) not in path
    assert configs is None


def test_the_command_works_elsewhere(installed: Path, tmp_path: Path) -> None:
    command = installed / "rbtm-bench"
    assert "usage" in run(command, "--help", cwd=tmp_path).lower()
    listed = run(command, "list", cwd=tmp_path)
    assert "rbtm" in listed and "previous" in listed
    out = tmp_path / "a run"
    run(
        command,
        "run",
        "dataset.scans=5",
        "backend=none",
        "selector=previous",
        f"out='{out}'",
        cwd=tmp_path,
    )
    assert json.loads((out / "run.json").read_text("utf-8"))["status"] == "done"
    assert len((out / "trajectory.tum").read_text("utf-8").splitlines()) == 5
