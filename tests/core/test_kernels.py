"""Compiled kernels: old machine code is never taken for new."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from rbtm_bench.core import kernels

INNER = "from rbtm_bench.core.kernels import kernel\n\n@kernel\ndef inner(x):\n    return x + {}\n"
OUTER = (
    "from rbtm_bench.core.kernels import kernel\nfrom kernels_of.inner import inner\n\n"
    "@kernel\ndef outer(x):\n    return 10 * inner(x)\n"
)


def test_the_digest_is_that_of_the_files_with_kernels(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(INNER.format(1))
    (tmp_path / "b.py").write_text("nothing = 0\n")
    first = kernels.digest(tmp_path)
    (tmp_path / "b.py").write_text("nothing = 1\n")
    assert kernels.digest(tmp_path) == first
    (tmp_path / "a.py").write_text(INNER.format(2))
    second = kernels.digest(tmp_path)
    (tmp_path / "a.py").rename(tmp_path / "c.py")
    assert len({first, second, kernels.digest(tmp_path)}) == 3


def test_every_module_with_kernels_is_in_the_digest() -> None:
    package = Path(kernels.__file__).parents[1]
    for path in package.rglob("*.py"):
        source = path.read_bytes()
        for numba_s_own in (b"njit", b"numba.vectorize", b"guvectorize"):
            assert numba_s_own not in source or path.name == "kernels.py", f"{path}: use @kernel"
        for ours in (b"\n@kernel\n", b"\n@broadcasting("):
            assert ours not in source or kernels.USE in source, path


def test_numba_s_own_setting_is_left_as_it_was() -> None:
    before = numba.config.CACHE_DIR

    @kernels.kernel
    def double(x: float) -> float:
        return 2.0 * x

    after = numba.config.CACHE_DIR
    assert after == before
    assert double(2.0) == 4.0


def ask(folder: Path, digest: str, cache: Path) -> str:
    """outer(1) in a new process, for sources whose digest is this."""
    code = (
        f"from rbtm_bench.core import kernels; kernels.digest = lambda: {digest!r}\n"
        "from kernels_of.outer import outer; print(outer(1))"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "PYTHONPATH": str(folder)}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


@pytest.mark.slow
def test_an_edit_of_a_kernel_that_is_called_counts(tmp_path: Path) -> None:
    package = tmp_path / "kernels_of"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "outer.py").write_text(OUTER)
    (package / "inner.py").write_text(INNER.format(1))
    cache = tmp_path / "cache"
    assert ask(tmp_path, "one", cache) == "20"
    assert list((cache / "rbtm_bench" / "kernels-one").rglob("*.nbc"))
    (package / "inner.py").write_text(INNER.format(5))
    assert ask(tmp_path, "one", cache) == "20"  # numba's own rule: outer.py is what it was
    assert ask(tmp_path, "two", cache) == "60"


@pytest.mark.slow
def test_where_nothing_can_be_written_it_works_all_the_same(tmp_path: Path) -> None:
    package = tmp_path / "kernels_of"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "inner.py").write_text(INNER.format(1))
    (package / "outer.py").write_text(OUTER)
    cache = tmp_path / "no-folder"
    cache.write_text("a file")
    assert ask(tmp_path, "one", cache) == "20"


LOOK = """
import sys
from rbtm_bench.runs.settings import compose_settings
compose_settings(["backend=plicp", "similarity=overlap"])
assert not [name for name in sys.modules if name.partition(".")[0] in ("numba", "scipy")]
from rbtm_bench.core import kernels
from rbtm_bench.runs.assembly import build
from rbtm_bench.runs.settings import compose_settings
build(compose_settings([]).config["similarity"])
assert not kernels._waiting
from rbtm_bench.similarity.inner import inner
assert "compiled" in vars(inner)
"""


def test_who_looks_at_a_class_compiles_nothing_and_who_makes_one_everything() -> None:
    done = subprocess.run([sys.executable, "-c", LOOK], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
