"""The advice as a config file: ``--config-dir DIR +experiment=NAME``."""

from __future__ import annotations

from typing import Any

import yaml

from rbtm_bench.calibration.trial import Verdict

GROUPS = ("backend", "similarity", "guess", "selector")


def content(backend: str, verdict: Verdict, command: str) -> str:
    """The advice (or what to take instead of one that was withdrawn) as YAML, with all settings of
    the plug-ins that were run. Words on the command line still win."""
    trial = verdict.advice if verdict.kept else verdict.instead
    run = trial.runs[0][0]
    outcome = "kept" if verdict.kept else f"withdrawn: {verdict.advice.name}; instead"
    lines = [
        "# @package _global_",
        f"# Made by: {command}",
        f"# {backend}: {outcome} {trial.name}; error on the reported part {trial.median:.3g}",
        "defaults:",
        *(f"  - override /{group}: {run.choices[group]}" for group in GROUPS),
    ]
    nodes: dict[str, Any] = {
        group: {k: v for k, v in run.config[group].items() if k != "_target_"}
        for group in GROUPS
        if isinstance(run.config.get(group), dict)
    }
    plain = {group: node for group, node in nodes.items() if node}
    return "\n".join([*lines, yaml.safe_dump(plain, sort_keys=False)])
