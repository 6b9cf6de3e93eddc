"""rbtm-bench new: what it writes works as it stands, and keeps the contract."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from sweep_helpers import call

from rbtm_bench.cli.new import KINDS
from rbtm_bench.runs.plugins import constructor_parameters


def outside(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """A command of Python in a process of its own that knows nothing of the folder."""
    env = {k: v for k, v in os.environ.items() if k != "PYTEST_ADDOPTS"}
    return subprocess.run(
        [sys.executable, *words], cwd=folder, env=env, capture_output=True, text=True, timeout=600
    )


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_written(tmp_path: Path, kind: str) -> None:
    code, out, _ = call("new", kind, "my_own", cwd=tmp_path)
    assert code == 0
    files = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    expected = {"plugins/my_own.py", f"plugins/{kind}/my_own.yaml", "plugins/test_my_own.py"}
    assert files == expected and all(file in out for file in files)
    node = yaml.safe_load((tmp_path / f"plugins/{kind}/my_own.yaml").read_text())
    assert node.pop("_target_") == "my_own.MyOwn"
    target = f"rbtm_bench.scaffold.{kind}.New{kind.capitalize()}"
    assert set(node) == set(constructor_parameters(kind, target))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_its_own_test_passes(tmp_path: Path, kind: str) -> None:
    assert call("new", kind, f"fresh_{kind}", "--dir", "mine", cwd=tmp_path)[0] == 0
    test = tmp_path / "mine" / f"test_fresh_{kind}.py"
    done = outside(tmp_path, "-m", "pytest", "-q", "-p", "no:dash", str(test))
    assert done.returncode == 0, done.stdout[-3000:]
    assert "1 passed" in done.stdout


@pytest.mark.slow
def test_config_dir_is_on_the_import_path(tmp_path: Path) -> None:
    """Without PYTHONPATH, from another folder, in workers too."""
    for kind in ("backend", "selector"):
        assert call("new", kind, f"worked_{kind}", cwd=tmp_path)[0] == 0
    words = ("backend=worked_backend", "selector=worked_selector", "dataset.scans=8")
    words += ("controls=none", "--config-dir", "../plugins")
    (tmp_path / "elsewhere").mkdir()
    for command in ("run", "compare", "sweep"):
        more = ("hydra/launcher=joblib",) if command == "sweep" else ()
        program = ("-P", "-m", "rbtm_bench", command)  # -P: not even this folder
        done = outside(tmp_path / "elsewhere", *program, *words, *more, f"out={command}")
        assert done.returncode == 0, done.stderr
    assert list((tmp_path / "elsewhere").rglob("trajectory.tum"))


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ("backend my-icp", "my-icp: expected a name of letters"),
        ("backend class", "class: expected a name of letters"),
        ("backend plicp", "backend=plicp: is there already"),
        ("selector json", "json: a module of this name is there already"),
        ("selector numpy", "numpy: a module of this name is there already"),
        ("target taken", "taken.py: is there already"),
    ],
)
def test_mistakes(tmp_path: Path, words: str, error: str) -> None:
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "taken.py").write_text("mine")
    code, out, told = call("new", *words.split(), cwd=tmp_path)
    assert (code, out) == (2, "") and error in told and len(told.splitlines()) == 1
    assert [path.name for path in tmp_path.rglob("*.*")] == ["taken.py"]


def test_a_broken_library_is_one_line(tmp_path: Path) -> None:
    assert call("new", "backend", "wraps", "--dir", ".", cwd=tmp_path)[0] == 0
    (tmp_path / "broken_library.py").write_text("raise OSError('libGL.so.1: no such file')\n")
    code = (tmp_path / "wraps.py").read_text()
    (tmp_path / "wraps.py").write_text(code.replace('("open3d",)', '("broken_library",)'))
    words = ("--config-dir", ".", "--plugin", "backend=wraps")
    done = outside(tmp_path, "-m", "rbtm_bench.contract", *words)
    lines = (done.stdout + done.stderr).strip().splitlines()
    assert done.returncode == 4 and lines == [
        "ERROR: backend=wraps: the library itself is broken, not the plug-in: "
        "import broken_library: OSError: libGL.so.1: no such file"
    ]
