"""Write docs/backends.md from the config group, so that it cannot go stale.

python scripts/make_backend_page.py            write the page
python scripts/make_backend_page.py --check    exit code 1 if it is not what would be written
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rbtm_bench.core.files import write_text
from rbtm_bench.runs import plugins, settings

PAGE = Path(__file__).resolve().parents[2] / "docs" / "backends.md"
HEAD = """\
# Backends

`scripts/make_backend_page.py` writes this page from `configs/backend/`; a test holds it against
them. `rbtm-bench list backend` prints what is installed, plug-ins of yours included.

Whatever the backend: `converged` is False with fewer than 3 inliers, 2D scans move in the plane
only, fitness, inlier RMSE and localizability come from one evaluator ([metrics](metrics.md)), and a
run is pinned to one core, without which Open3D does not repeat its bits.

Lengths that easily become one number are settings of their own, each of which follows another until
it is set:

| setting (m) | of what | unless set |
|---|---|---|
| `registration.max_correspondence_distance` | correspondences, all backends | the data set's |
| `backend.max_correspondence_distance` | correspondences of this backend | the one above |
| `judge_radius` | fitness, RMSE and localizability | the backend's distance |
| `backend.normal_radius` (`open3d_*`) | neighbours that make a normal | the backend's distance |
| `backend.cell_size` (`small_gicp_vgicp`) | the target's cells | the backend's distance |
| `backend.map_voxel_size` (`kiss_icp`) | the target's cells | the backend's distance |
| `backend.voxel_size` | thinning of every scan | the data set's |
| `target.voxel_size` (`local_map`) | thinning of the merged map | the backend's |
| `backend.trim_floor` (`plicp...`) | what is not trimmed ([why](benchmarks.md)) | 0.03 |
"""
TABLE = """
| `backend=` | method | library | 2D | 3D | `converged` is true | repeats |
|---|---|---|---|---|---|---|
"""
SHARED = {
    "max_correspondence_distance": "farthest correspondence; the evaluator's unless `judge_radius`",
    "voxel_size": "0: every point",
}


def comments(path: Path) -> tuple[str, dict[str, tuple[str, str]]]:
    """A config's first line of comment, and its settings with default and comment."""
    lines = path.read_text(encoding="utf-8").splitlines()
    about = []
    for line in lines:
        if not line.startswith("#"):
            break
        about.append(line.lstrip("# "))
    described = {}
    for line in lines:
        match = re.fullmatch(r"(\w+): *(.*?)(?: +# *(.*))?", line)
        if match and match[1] != "_target_":
            described[match[1]] = (match[2].strip(), match[3] or SHARED.get(match[1], ""))
        elif described and re.fullmatch(r" +# *(.*)", line):  # a comment that goes on
            last = next(reversed(described))
            described[last] = (
                described[last][0],
                f"{described[last][1]} {line.lstrip(' #')}".strip(),
            )
    return " ".join(about), described


def row(name: str, cls: Any, about: str) -> str:
    """A line of the table of methods."""
    dimensions = getattr(cls, "dimensions", ())
    flat, space = ("yes" if d in dimensions else "" for d in ("2d", "3d"))
    converged_means = getattr(cls, "converged_means", "")
    method = about.rstrip(".").replace("|", "/")
    return (
        f"| [`{name}`](#{name}) | {method} | {cls.library} | {flat} | {space} | {converged_means} "
        f"| {cls.repeats} |"
    )


def section(name: str, described: dict[str, tuple[str, str]]) -> str:
    """A backend's settings."""
    lines = [f"\n## {name}\n", "| setting | default | |", "|---|---|---|"]
    for key, (default, comment) in described.items():
        shown = "the data set's" if "$" in default else f"`{default}`"
        lines.append(f"| `{key}` | {shown} | {comment.replace('|', '/')} |")
    return "\n".join(lines) + "\n"


def page() -> str:
    """The whole page."""
    rows, sections = [], []
    for name in settings.members("backend"):
        about, described = comments(settings.config_dir() / "backend" / f"{name}.yaml")
        node = settings.compose_settings([f"backend={name}"]).config["backend"]
        cls = plugins.locate(f"backend={name}", node["_target_"])
        rows.append(row(name, cls, about))
        sections.append(section(name, described))
    return HEAD + TABLE + "\n".join(rows) + "\n" + "".join(sections)


def main(argv: Sequence[str] | None = None) -> int:
    """Write or check."""
    words = sys.argv[1:] if argv is None else list(argv)
    if words not in ([], ["--check"]):
        print(__doc__)
        return 2
    text = page()
    if words:
        same = PAGE.is_file() and PAGE.read_text(encoding="utf-8") == text
        print(f"{PAGE.name}: {'up to date' if same else 'run scripts/make_backend_page.py'}")
        return 0 if same else 1
    write_text(PAGE, text)
    print(PAGE)
    return 0
