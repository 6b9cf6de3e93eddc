"""The subcommand that fetches published logs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rbtm_bench.core.errors import ConfigError, RbtmBenchError
from rbtm_bench.datasets.published import (
    CITATION,
    LICENCE,
    PUBLISHED,
    SERVER,
    Published,
    Remote,
    home,
    published,
    state,
)


def download(words: list[str]) -> int:
    """``rbtm-bench download NAME ...``."""
    parser = argparse.ArgumentParser(
        prog="rbtm-bench download",
        description="Fetch published logs and their relations; then dataset=NAME reads them.\n"
        "Without a name: which there are, and which are on this machine.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="example: rbtm-bench download aces intel\n"
        "A transfer that breaks off is gone on with by the same command.",
        allow_abbrev=False,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(PUBLISHED))
    parser.add_argument(
        "--from",
        dest="server",
        metavar="URL",
        default=SERVER,
        help="a mirror (default: %(default)s)",
    )
    options = parser.parse_args(words)
    if not options.server.startswith(("http://", "https://")):
        raise ConfigError(f"--from {options.server}: expected http:// or https://")
    logs = {name: published(name) for name in dict.fromkeys(options.names)}
    print(f"licence {LICENCE}; cite: {CITATION}")
    if not logs:
        for name, log in PUBLISHED.items():
            print(f"{name:<12} {_size(log)}, {log.words} [{state(name)}]")
    failed = [name for name, log in logs.items() if not _fetched(name, log, options.server)]
    return 1 if failed else 0


def _fetched(name: str, log: Published, server: str) -> bool:
    """Fetch what a log lacks; prints what became of it."""
    print(f"{name}: {log.words}, {_size(log)}", flush=True)
    try:
        for file in log.files:
            _fetch(file, home() / "freiburg", server)
    except RbtmBenchError as error:
        print(f"rbtm-bench: {error}", file=sys.stderr)
        return False
    print(f"  read by dataset={name}")
    return True


def _fetch(file: Remote, folder: Path, server: str) -> None:
    from rbtm_bench.datasets.download import fetch
    from rbtm_bench.engine.progress import bar

    with bar("bytes", file.size) as progress:
        outcome = fetch(file, folder, progress.update_to, server)
    verb = "fetched" if outcome.fetched else "present"
    print(f"  {verb} {outcome.path} ({outcome.check})", flush=True)


def _size(log: Published) -> str:
    sizes = [file.size for file in log.files]
    return f"{sum(filter(None, sizes)) / 1e6:.1f} MB" if None not in sizes else "size not known"
