"""The subcommand that begins a plug-in: new."""

from __future__ import annotations

import argparse
import importlib.util
import inspect
import keyword
import sys
from pathlib import Path

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.files import make_folder, write_text

KINDS = ("backend", "selector", "similarity", "target", "dataset")
FROM_DATA = ("max_correspondence_distance", "voxel_size")
"""Settings that a backend takes from the data set's config."""

TEST = '''"""The rules that every {kind} keeps: python -m pytest {file}"""

import subprocess
import sys
from pathlib import Path
{imports}

def test_contract(tmp_path: Path) -> None:
    words = ["--config-dir", str(Path(__file__).parent), "--plugin", "{kind}={name}"]
{data}    command = [sys.executable, "-m", "rbtm_bench.contract", "-q", *words]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
'''
DATA = """    for number in range(12):
        points = np.random.default_rng(number).uniform(-5, 5, (100, 3))
        np.save(tmp_path / f"{number:02}.npy", points)
    words += ["--override", f"dataset.path={tmp_path}"]
"""


def new(words: list[str]) -> int:
    """``rbtm-bench new KIND NAME``: class, YAML and test in a folder of the user's."""
    parser = argparse.ArgumentParser(
        prog="rbtm-bench new",
        description="Begin a plug-in of your own: writes a class that works and is there to be "
        "changed, its YAML and its test (which wants pytest).",
        epilog="example: rbtm-bench new selector newest_similar && rbtm-bench run "
        "selector=newest_similar --config-dir plugins",
    )
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("name", metavar="NAME", help="as on the command line: backend=NAME")
    parser.add_argument(
        "--dir", type=Path, default=Path("plugins"), help="the folder (default: plugins)"
    )
    options = parser.parse_args(words)
    kind, name, folder = options.kind, options.name, options.dir
    _refuse(kind, name)
    files = contents(kind, name)
    for file in files:
        if (folder / file).exists():
            raise ConfigError(f"{folder / file}: is there already; choose another name, or --dir")
    for file, text in files.items():
        make_folder((folder / file).parent)
        write_text(folder / file, text)
        print(folder / file)
    use = f"run {kind}={name}" + (" dataset.path=..." if kind == "dataset" else "")
    print(f"use it:   rbtm-bench {use} --config-dir {folder}")
    print(f"test it:  python -m pytest {folder / f'test_{name}.py'}   (wants pytest)")
    return 0


def contents(kind: str, name: str) -> dict[str, str]:
    """The files of a new plug-in by their places in its folder."""
    module = importlib.import_module(f"rbtm_bench.scaffold.{kind}")
    old, own = f"New{kind.capitalize()}", "".join(map(str.capitalize, name.split("_")))
    lines = [f"_target_: {name}.{own}"]
    for key, parameter in inspect.signature(getattr(module, old)).parameters.items():
        lines.append(f"{key}: {_default(kind, key, parameter)}")
    is_data = kind == "dataset"
    test = TEST.format(
        kind=kind,
        name=name,
        file=f"test_{name}.py",
        imports="\nimport numpy as np\n" if is_data else "",
        data=DATA if is_data else "",
    )
    return {
        f"{name}.py": inspect.getsource(module).replace(old, own),
        f"{kind}/{name}.yaml": "\n".join(lines) + "\n",
        f"test_{name}.py": test,
    }


def _default(kind: str, key: str, parameter: inspect.Parameter) -> str:
    if kind == "backend" and key in FROM_DATA:
        return f"${{registration.{key}}}"
    return "???" if parameter.default is parameter.empty else str(parameter.default)


def _refuse(kind: str, name: str) -> None:
    """Raise ``ConfigError`` for a name that no module, or no member of the group, can have."""
    from rbtm_bench.runs.settings import members

    if not name.isidentifier() or not name.isascii() or keyword.iskeyword(name):
        raise ConfigError(f"{name}: expected a name of letters, digits and _, as of a module")
    if name in members(kind):
        raise ConfigError(f"{kind}={name}: is there already; choose another name")
    if name in sys.stdlib_module_names or importlib.util.find_spec(name) is not None:
        raise ConfigError(f"{name}: a module of this name is there already; choose another name")
