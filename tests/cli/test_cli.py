"""The command line: help at once, exit codes, one line an error, pipes that close."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rbtm_bench import __version__
from rbtm_bench.cli.commands import HELP, main

COMMANDS = (
    "run",
    "compare",
    "sweep",
    "table",
    "show",
    "diff",
    "plot",
    "report",
    "gate",
    "export",
    "new",
    "list",
    "doctor",
)
HEAVY = ("numpy", "scipy", "hydra", "omegaconf", "pydantic", "pandas", "matplotlib", "open3d")


@pytest.fixture(autouse=True)
def unpinned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands called in this process leave it on all of its cores."""
    monkeypatch.setattr("rbtm_bench.runs.pinning.pin_to_free_core", lambda: None)


def process(*words: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own, away from the repository."""
    env = {k: v for k, v in os.environ.items() if k != "HYDRA_FULL_ERROR"}
    return subprocess.run(
        [sys.executable, "-m", "rbtm_bench", *words],
        cwd=cwd,
        env={**env, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


def small(out: Path, *words: str) -> list[str]:
    """The words of a small run that does not pin this process."""
    return ["backend=none", "dataset.scans=8", "pin=false", f"out='{out}'", *words]


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("cli") / "out"
    assert main(["compare", *small(out), "selector=previous,rbtm", "--jobs", "1"]) == 0
    return out


# --- help


def test_help_answers_at_once(tmp_path: Path) -> None:
    times = []
    for _ in range(3):
        started = time.perf_counter()
        done = process("--help", cwd=tmp_path)
        times.append(time.perf_counter() - started)
        assert (done.returncode, done.stdout, done.stderr) == (0, HELP, "")
    assert min(times) < 0.5, times


@pytest.mark.parametrize("words", [["--help"], ["--version"], ["compare", "--help"], ["nix"]])
def test_what_answers_at_once_imports_nothing_heavy(tmp_path: Path, words: list[str]) -> None:
    code = (
        "import json, sys; from rbtm_bench.cli.commands import main; main(sys.argv[1:]);"
        "print(json.dumps(sorted(m for m in sys.modules if '.' not in m)), file=sys.stderr)"
    )
    command = [sys.executable, "-c", code, *words]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    loaded = set(json.loads(done.stderr.splitlines()[-1]))
    assert not loaded & set(HEAVY)


def test_libraries_load_only_where_used(tmp_path: Path) -> None:
    (tmp_path / "a.clf").write_text("".join(log_line(stamp=float(i)) for i in range(3)))
    code = "import sys; from rbtm_bench.cli.commands import main; main(sys.argv[1:]);"
    code += "print(*sys.modules)"
    words = ["run", "dataset=carmen", "dataset.path=a.clf", "backend=none", "selector=previous"]
    command = [sys.executable, "-c", code, *words, "out=out"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert (tmp_path / "out" / "metrics.json").exists() and "numpy" in loaded
    assert not loaded & {"open3d", "kiss_icp", "matplotlib"}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("flag", ["--help", "-h"])
def test_help_of_every_command(command: str, flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, flag]) == 0
    text = capsys.readouterr().out
    assert text.startswith(f"usage: rbtm-bench {command}")
    assert command in HELP
    assert all(len(line) <= 100 for line in text.splitlines())


def test_examples_of_the_help_compose(capsys: pytest.CaptureFixture[str]) -> None:
    """What is shown can be typed: every key=value on its own is known."""
    from rbtm_bench.runs.grid import make_points

    for command in ("run", "compare", "sweep"):
        capsys.readouterr()
        assert main([command, "--help"]) == 0
        lines = capsys.readouterr().out.splitlines()
        examples = [line.split() for line in lines if line.startswith(f"  rbtm-bench {command} ")]
        assert examples
        for words in examples:
            given = [w for w in words[2:] if "=" in w and not w.startswith("hydra/")]
            assert make_points(given)[0]


def test_no_words_at_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert capsys.readouterr().out == HELP
    assert main(["help"]) == 0


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    for flag in ("--version", "-V"):
        assert main([flag]) == 0
        assert capsys.readouterr().out == f"rbtm-bench {__version__}\n"


# --- mistakes


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("runn", "runn: no such command. Did you mean run? Known: run, compare"),
        ("xyz", "xyz: no such command. Known: run, compare"),
        ("run selector", "selector: expected key=value"),
        ("run =3", "=3: expected key=value"),
        ("run --fast", "--fast: no such option; see rbtm-bench run --help"),
        ("compare --job=2", "--job=2: no such option"),
        ("run selector.threshold=high", "selector.threshold=high: "),
        ("run backend=nix", "backend=nix: no such backend."),
        ("run --config-dir nowhere", "--config-dir nowhere: no such folder"),
        ("list --config-dir nowhere", "--config-dir nowhere: no such folder"),
        ("sweep selector.threshold=0.5,high", "selector.threshold=high: "),
        ("sweep out=a,b", "out=a,b: a sweep has one folder"),
        ("table nowhere", "nowhere: no such file or folder"),
        ("plot nowhere", "nowhere: no such file or folder"),
        ("run --cfg job backend=nix", "backend=nix: no such backend."),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(
    words: str, named: str, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(words.split()) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(f"rbtm-bench: {named}")
    assert len(captured.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", ["table", "table --format nix x", "list nix", "doctor x"])
def test_argparse_mistakes_are_exit_code_2_too(
    words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words.split()) == 2
    assert "error: " in capsys.readouterr().err


def test_streams_and_codes_of_a_process(tmp_path: Path) -> None:
    done = process("run", "selector.window=0", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "rbtm-bench: selector.window=0: input should be greater than or equal to 2\n"
    )
    done = process("run", *small(tmp_path / "out"), cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("corridor, none, rbtm: 8 scans in ")
    assert f"results in {tmp_path / 'out'}" in done.stdout


def test_debug_shows_where(tmp_path: Path) -> None:
    for words, environment in (
        (["run", "--debug", "selector.window=0"], {}),
        (["run", "selector.window=0"], {"HYDRA_FULL_ERROR": "1"}),
    ):
        done = process(*words, cwd=tmp_path, **environment)
        assert done.returncode == 2
        assert "Traceback" in done.stderr and "settings.py" in done.stderr
        assert "ConfigError: selector.window=0" in done.stderr.splitlines()[-1]


# --- what Hydra answers


def test_cfg_job_prints_the_composed_settings(tmp_path: Path) -> None:
    for flag in (["--cfg", "job"], ["--cfg=job"], ["-c", "job"]):
        done = process("run", *flag, "backend=kiss_icp", "selector.window=33", cwd=tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
        assert "kiss_icp.KissICP" in done.stdout and "window: 33" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_sweep_is_a_multirun(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "it's, a = sweep"
    quoted = str(out).replace("'", "\\'")
    words = ["backend=none", "dataset.scans=8", "pin=false", "selector.threshold=0.5,0.6"]
    assert main(["sweep", *words, f"out='{quoted}'"]) == 0
    assert {p.parent.name for p in out.glob("*/run.json")} == {"0", "1"}
    assert (out / "table.csv").exists() and (out / "summary.csv").exists()
    assert "threshold" in capsys.readouterr().out
    assert main(["sweep", *words, f"out='{quoted}'"]) == 2
    assert "overwrite=true" in capsys.readouterr().err


def test_bad_data_end_a_sweep_before_it_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["dataset=carmen", "dataset.path=nowhere.clf", "pin=false", "seed=1,2"]
    assert main(["sweep", *words, f"out='{tmp_path / 'out'}'"]) == 2
    assert "nowhere.clf" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# --- logs that are missing, empty, malformed or truncated


def log_line(readings: int = 180, stamp: float = 0.0) -> str:
    numbers = [1.0] * readings + [0.0] * 6
    return f"FLASER {readings} {' '.join(map(str, numbers))} {stamp} host 0.5\n"


def bad_logs(folder: Path) -> dict[str, str]:
    """File name -> what the message says of it."""
    import gzip

    good = log_line() + log_line(stamp=1.0)
    (folder / "empty.clf").touch()
    (folder / "blank.clf").write_text("\n\n")
    (folder / "other.clf").write_text("hello\n")
    (folder / "short.clf").write_text(good + "FLASER 180 1 2 3\n")
    (folder / "word.clf").write_text(good + log_line(stamp=2.0).replace("1.0", "one", 1))
    (folder / "beams.clf").write_text(good + log_line(readings=7))
    packed = gzip.compress((good * 50).encode())
    (folder / "truncated.clf.gz").write_bytes(packed[: len(packed) // 2])
    (folder / "nothing.clf.gz").write_bytes(gzip.compress(b""))
    (folder / "binary.clf").write_bytes(b"\0\1\2" * 99)
    (folder / "a folder.clf").mkdir()
    return {
        "missing.clf": "No such file",
        "empty.clf": "empty",
        "blank.clf": "empty",
        "other.clf": "no FLASER line",
        "short.clf": "line 3, FLASER: expected 191 words",
        "word.clf": "line 3, range: expected a number, 'one' found",
        "beams.clf": "line 3, number of readings: expected 180 as before",
        "truncated.clf.gz": "truncated",
        "nothing.clf.gz": "empty",
        "binary.clf": "binary data",
        "a folder.clf": "expected a file, found a folder",
    }


@pytest.mark.parametrize("command", ["run", "compare"])
def test_bad_logs_are_one_line_and_leave_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    for name, why in bad_logs(tmp_path).items():
        path = tmp_path / name
        out = tmp_path / "out"
        words = ["dataset=carmen", f"dataset.path='{path}'", "backend=none", f"out='{out}'"]
        assert main([command, *words, "pin=false"]) == 2, name
        error = capsys.readouterr().err
        assert error.startswith(f"rbtm-bench: {path}") and why in error, error
        assert len(error.splitlines()) == 1
        assert not out.exists()


# --- tables and pipes


def test_table_of_a_comparison(compared: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["table", str(compared), "--columns", "run,scans", "--format", "csv"]) == 0
    assert capsys.readouterr().out == "run,scans\nnone-previous,8\nnone-rbtm,8\n"
    assert main(["table", str(compared / "none-rbtm"), "--over-seeds", "-f", "json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["seeds"] == 1
    assert main(["table", str(compared), "--columns", "runs"]) == 2
    assert "--columns runs: no such column" in capsys.readouterr().err


@pytest.mark.parametrize("words", ["table {out} --format csv", "--help", "list", "run --help"])
def test_a_reader_that_leaves_early(compared: Path, tmp_path: Path, words: str) -> None:
    """As in `rbtm-bench table x | head -1`: no traceback, whenever the pipe closes."""
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "rbtm_bench", *words.format(out=compared).split()],
        cwd=tmp_path,
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_console_script_is_the_module(tmp_path: Path) -> None:
    script = Path(sys.executable).parent / "rbtm-bench"
    if not script.exists():
        pytest.skip("the console script is not installed in this environment")
    for words in (["--version"], ["run", "selector.window=0"], ["list", "guess"]):
        done = subprocess.run([script, *words], cwd=tmp_path, capture_output=True, text=True)
        ours = process(*words, cwd=tmp_path)
        assert (done.returncode, done.stdout, done.stderr) == (
            ours.returncode,
            ours.stdout,
            ours.stderr,
        )
