"""KISS-ICP's loaders that need a maker's package: said where it is absent, read where it is there.

The packages are stood in for by modules with what the loaders call.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.datasets.kiss_loader import KissFormat

POINTS = np.random.default_rng(0).uniform(-9, 9, (50, 3)).astype(np.float32)

DEVKIT = {
    "nuscenes/__init__.py": "",
    "nuscenes/utils/__init__.py": "",
    "nuscenes/utils/splits.py": "def create_splits_logs(split, nusc):\n    return ['log']\n",
    "nuscenes/utils/data_classes.py": "class LidarPointCloud:\n    from_file = None\n",
    "nuscenes/utils/geometry_utils.py": """
import numpy as np
def transform_matrix(translation, rotation):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.rotation_matrix, translation
    return T
""",
    "nuscenes/nuscenes.py": """
class NuScenes:
    def __init__(self, dataroot, version):
        self.dataroot = dataroot
        self.scene = [dict(name='scene-0061', token='s')]
    def list_scenes(self):
        print('scene-0061')
    def get(self, table, token):
        if table == 'scene':
            return dict(token='s', log_token='l', first_sample_token='f')
        if table == 'log':
            return dict(logfile='log')
        if table == 'sample':
            return dict(data={'LIDAR_TOP': '0'})
        if table == 'sample_data':
            i = int(token)
            return dict(token=token, filename=f'samples/{i}.pcd.bin',
                        timestamp=1533201470 * 10**6 + 50000 * i,
                        calibrated_sensor_token='c', ego_pose_token=token,
                        next=str(i + 1) if i < 2 else '')
        move = 0.5 * int(token) if table == 'ego_pose' else 0.0
        return dict(translation=[move, 0.0, 0.0], rotation=[1.0, 0.0, 0.0, 0.0])
""",
}
SDK = {
    "ouster/__init__.py": "",
    "ouster/sdk/__init__.py": """
import numpy as np
from types import SimpleNamespace as Namespace
class Scan:
    w, h = 8, 4
    def __init__(self, number):
        self.timestamp, self.number = [number * 10**8], number
    def field(self, name):
        return np.ones((self.h, self.w))
class Source(list):
    metadata = None
def open_source(path, meta, index):
    return Source([Scan(1), Scan(2)])
client = Namespace(
    XYZLut=lambda metadata: lambda scan: np.full((scan.h, scan.w, 3), float(scan.number)),
    ChanField=Namespace(RANGE='RANGE'),
)
""",
}


def install(modules: dict[str, str], folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, text in modules.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    monkeypatch.syspath_prepend(str(folder))
    for name in [n for n in sys.modules if n.split(".")[0] in ("nuscenes", "ouster")]:
        monkeypatch.delitem(sys.modules, name)


@pytest.mark.parametrize(
    ("loader", "package", "sequence"),
    [("nuscenes", "nuscenes-devkit", 61), ("ouster", "ouster-sdk", None)],
)
def test_an_absent_package_is_named(
    tmp_path: Path, loader: str, package: str, sequence: int | None
) -> None:
    with pytest.raises(ConfigError, match=f"dataset={loader} needs {package}: pip install"):
        KissFormat(str(tmp_path), loader, sequence)  # type: ignore[arg-type]


def test_nuscenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(DEVKIT, tmp_path / "site", monkeypatch)
    (tmp_path / "samples").mkdir()
    for i in range(3):
        rows = np.column_stack([POINTS + i, np.zeros((50, 2))]).astype("<f4")
        rows.tofile(tmp_path / "samples" / f"{i}.pcd.bin")
    data = KissFormat(str(tmp_path), "nuscenes", 61)
    assert len(data) == 3
    np.testing.assert_allclose(data.stamps, 1533201470 + 0.05 * np.arange(3), atol=1e-6)
    np.testing.assert_allclose(data[1].points, POINTS + 1, atol=1e-6)
    assert data[2].ground_truth is not None
    np.testing.assert_allclose(data[2].ground_truth[:3, 3], [1.0, 0, 0])
    with pytest.raises(DataError, match="not available scenes"):
        KissFormat(str(tmp_path), "nuscenes", 62)


def test_ouster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(SDK, tmp_path / "site", monkeypatch)
    file = tmp_path / "a.pcap"
    file.write_bytes(b"packets")
    data = KissFormat(str(file), "ouster", rate_hz=20.0)
    assert len(data) == 2 and not data.has_ground_truth
    np.testing.assert_allclose(data.stamps, [0.0, 0.05])
    np.testing.assert_array_equal(data[1].points, np.full((32, 3), 2.0))
    before = data.fingerprint()
    file.write_bytes(b"others")
    assert KissFormat(str(file), "ouster", rate_hz=20.0).fingerprint() != before
    with pytest.raises(DataError, match="found a folder"):
        KissFormat(str(tmp_path), "ouster")
