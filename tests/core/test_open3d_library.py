"""Open3D without the web framework, which comes when it is asked for."""

from __future__ import annotations

import subprocess
import sys

CODE = """
import sys
from rbtm_bench.core.open3d_library import open3d
library = open3d()
assert library is sys.modules["open3d"] and "dash" not in sys.modules
assert library is open3d()
import open3d.visualization
viewer = sys.modules["open3d.visualization.draw_plotly"]
assert viewer.html.Div.__name__ == "Div" and "dash" in sys.modules
"""


def test_the_viewer_s_framework_is_loaded_when_it_is_used() -> None:
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
