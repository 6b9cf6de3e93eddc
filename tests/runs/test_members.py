"""The members of a config group, read from their own files."""

from __future__ import annotations

from pathlib import Path

import pytest

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.runs import settings
from rbtm_bench.runs.declared import PLUGIN_GROUPS


def test_members_as_written_are_members_as_composed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reading a member's own file gives what composing it gives; one that inherits is composed."""
    folder = tmp_path / "backend"
    folder.mkdir()
    (folder / "mine.yaml").write_text("defaults: [open3d_p2p]\nmax_iterations: 7\n")
    (folder / "broken.yaml").write_text("a: [1\n")
    (folder / "elsewhere.yaml").write_text("# @package other\n_target_: a.B\n")
    written = {group: settings.member_nodes(group, (tmp_path,)) for group in PLUGIN_GROUPS}
    monkeypatch.setattr(settings, "_written", lambda *_: None)
    for group in PLUGIN_GROUPS:
        composed = settings.member_nodes(group, (tmp_path,))
        assert list(written[group]) == list(composed)
        for name, node in composed.items():
            assert str(written[group][name]) == str(node), name
    assert written["backend"]["mine"]["max_iterations"] == 7
    assert isinstance(written["backend"]["broken"], ConfigError)
