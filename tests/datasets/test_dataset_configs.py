"""The configs name every parameter of their class, with its default."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ConfigDict, ValidationError, create_model

CONFIGS = Path(__file__).parents[2] / "configs" / "dataset"
NAMES = ("corridor", "carmen", "cloud_folder", "kitti", "bag", "bag_clouds", "simulated")


def _load(name: str) -> tuple[dict[str, Any], type]:
    section = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text())["dataset"]
    module, class_name = section.pop("_target_").rsplit(".", 1)
    return section, getattr(importlib.import_module(module), class_name)


@pytest.mark.parametrize("name", NAMES)
def test_config_and_class_agree(name: str) -> None:
    section, cls = _load(name)
    parameters = inspect.signature(cls).parameters
    assert list(section) == list(parameters)
    for key, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty:
            assert section[key] == "???"
        elif key != "seed":
            assert section[key] == parameter.default, key
            assert type(section[key]) is type(parameter.default), key


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("corridor", {"scans": 1}),
        ("corridor", {"environment": "moon"}),
        ("corridor", {"field_of_view_deg": 361.0}),
        ("corridor", {"range_noise": -0.1}),
        ("carmen", {"stride": 0}),
        ("carmen", {"corrected": "maybe"}),
        ("carmen", {"order": "random"}),
        ("carmen", {"max_range": 0.0}),
        ("cloud_folder", {"rate_hz": 0.0}),
        ("cloud_folder", {"on_error": "ignore"}),
        ("bag", {"tolerance_s": 0.0}),
        ("bag", {"topic": 3}),
        ("simulated", {"beams": 17}),
        ("simulated", {"place": "moon"}),
        ("simulated", {"dropout": 1.0}),
        ("kitti", {"sequence": -1}),
        ("kitti", {"ground_truth_frames": [3]}),
    ],
)
def test_annotations_can_be_checked(name: str, change: dict[str, Any]) -> None:
    section, cls = _load(name)
    hints = inspect.get_annotations(cls.__init__, eval_str=True)
    hints.pop("return")
    fields: dict[str, Any] = {key: (hint, ...) for key, hint in hints.items()}
    model = create_model("Settings", __config__=ConfigDict(extra="forbid"), **fields)
    values = {**section, "seed": 0} if name in ("corridor", "simulated") else section
    model(**values)
    with pytest.raises(ValidationError, match=next(iter(change))):
        model(**{**values, **change})
