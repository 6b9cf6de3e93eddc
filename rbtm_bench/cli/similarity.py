"""The subcommand that computes and draws scores of a data set: similarity."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.engine.progress import bar

if TYPE_CHECKING:
    from rbtm_bench.runs.settings import Settings
    from rbtm_bench.similarity.scorematrix import Scores

HELP = """\
How similar are the scans of a data set? The matrix of all pairs (the paper's Fig. 1c), or the band
of every scan with those that a window holds.

examples
  rbtm-bench similarity                                             the embedded corridor
  rbtm-bench similarity dataset=carmen dataset.path=aces.clf.gz similarity=curvature_circular
  rbtm-bench similarity dataset=carmen dataset.path=aces.clf.gz --band selector.window=100
  rbtm-bench similarity similarity=curvature dataset.range_noise=0

Scores are computed in blocks within --memory MB (beside the program itself) and kept as float32: a
matrix of n scans takes 4 n^2 bytes, descriptors and blocks some more, so 1000 MB hold some 13000
scans. What does not fit is refused before it begins.

The folder (--out, or out=DIR) holds similarity.npz, settings.yaml and similarity.png, .pdf. Of
thousands of scans every n-th is drawn, which the title says; the file has all of them.

similarity.npz
  scores    matrix: (N, N), row j is scan j as the new scan, column k scan k as its model
            band:   (N, W - 1), column g - 1 is scan j with scan j - g; NaN before the first scan
  scans     (N,) numbers           stamps (N,) s           metres (N,) travelled, if known
  settings  the composed settings, as JSON
A similarity that compares scans under a guess gets odometry between the two, else no motion."""


def similarity(words: list[str]) -> int:
    """``rbtm-bench similarity``."""
    options, overrides = _parse(words)
    from rbtm_bench.cli.runs import pin_unless_lifted
    from rbtm_bench.runs.claim import default_folder

    pin_unless_lifted(overrides)  # numpy sizes its thread pool when it is imported
    from rbtm_bench.runs.assembly import build
    from rbtm_bench.runs.claim import refuse_existing
    from rbtm_bench.runs.settings import compose_settings
    from rbtm_bench.similarity import scorematrix

    if not options.memory > 0:
        raise ConfigError(f"--memory {options.memory:g}: expected megabytes above 0")
    settings = compose_settings(overrides, tuple(map(Path, options.config_dir)))
    config = settings.config
    if "similarity" not in config:
        raise ConfigError(
            f"backend={settings.choices['backend']}: leave it out, it takes no similarity"
        )
    if options.out and config["out"]:
        raise ConfigError("--out and out=: give one of them")
    window = _window(config) if options.band else None
    out = Path(options.out or config["out"] or default_folder("similarity"))
    refuse_existing(out, bool(config["overwrite"]))
    dataset, plugin = build(config["dataset"]), build(config["similarity"])
    plugin.check(dataset)
    stride = config["dataset"].get("stride")
    started = time.perf_counter()
    with bar("scans") as progress:
        scores = scorematrix.compute(
            dataset, plugin, window, options.memory, progress.update_to, stride
        )
    seconds = time.perf_counter() - started
    _write(scores, settings, out)
    print(_summary(scores, settings, seconds, out))
    return 0


def _window(config: dict[str, Any]) -> int:
    window = config["selector"].get("window")
    if window is None:
        raise ConfigError("--band: the selector has no window; add selector=rbtm selector.window=W")
    return int(window)


def _write(scores: Scores, settings: Settings, out: Path) -> None:
    from rbtm_bench.core.files import make_folder
    from rbtm_bench.plots import style
    from rbtm_bench.plots.scores import draw
    from rbtm_bench.runs.experiment import write_config

    make_folder(out)
    scores.write(out / "similarity.npz", settings.config)
    write_config(out, settings)
    (out / "config.yaml").replace(out / "settings.yaml")  # config.yaml would say: a run
    data, similarity = (settings.choices[group] for group in ("dataset", "similarity"))
    path = settings.config["dataset"].get("path")
    name = data if path is None else f"{data} {Path(str(path)).name}"
    with style.paper():
        style.save(draw(scores, name, similarity), out, "similarity")


def _summary(scores: Scores, settings: Settings, seconds: float, out: Path) -> str:
    import numpy as np

    shape = " x ".join(map(str, scores.scores.shape))
    name = settings.choices["similarity"]
    kind = "matrix" if scores.window is None else f"band, window {scores.window}"
    size = scores.scores.nbytes / 1e6
    lines = [f"{kind} of {name}: {shape} scores, {size:.1f} MB as float32, {seconds:.1f} s"]
    gaps = [g for g in (1, 2, 5, 10, 20, 50, 100, 200, 500) if g < scores.widest]
    words = []
    for gap in gaps:
        values = scores.at_gap(gap)
        defined = values[np.isfinite(values)]
        words.append(f"{gap}: {np.median(defined):.2f}" if len(defined) else f"{gap}: -")
    if words:
        lines.append("median score by gap: " + ", ".join(words))
    share = scores.undefined_share
    if share:
        lines.append(f"undefined: {share:.2%} of the pairs")
    if scores.guess:
        lines.append(f"compared under a guess: {scores.guess}")
    lines.append(f"{out}: similarity.npz, similarity.png, similarity.pdf, settings.yaml")
    return "\n".join(lines)


def _parse(words: list[str]) -> tuple[argparse.Namespace, list[str]]:
    from rbtm_bench.cli.calibrate import overrides_of

    parser = argparse.ArgumentParser(
        prog="rbtm-bench similarity",
        description=HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="rbtm-bench similarity [key=value ...] [--matrix | --band] [options]",
        allow_abbrev=False,
    )
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--matrix", action="store_true", help="all pairs of scans (the default)")
    kind.add_argument(
        "--band", action="store_true", help="every scan with the selector.window - 1 before it"
    )
    parser.add_argument(
        "--memory", type=float, default=1000.0, metavar="MB", help="at most (default 1000)"
    )
    parser.add_argument("--out", metavar="DIR", help="default results/similarity/TIME")
    parser.add_argument("--config-dir", "-cd", action="append", default=[], metavar="DIR")
    options, rest = parser.parse_known_args(words)
    return options, overrides_of("similarity", rest)
