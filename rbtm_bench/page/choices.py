"""How every scan's model was chosen, replayed: the window, the scores, what became of each.

A run stores which model scan it took, not what it was chosen from. The selector's own window and
the similarity give that again, from the stored poses and the scans; where the choice comes out
otherwise than stored the page counts it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array, Node
from rbtm_bench.guess.base import Guess
from rbtm_bench.page import scans as reading
from rbtm_bench.page.packing import MISSING, packed
from rbtm_bench.page.runs import Track, packed_poses
from rbtm_bench.page.scans import Scans
from rbtm_bench.runs import assembly, replicate
from rbtm_bench.selection.base import Selection, Selector
from rbtm_bench.selection.window import Window
from rbtm_bench.similarity.base import Similarity

CELLS = 1_200_000
"""Candidates of all scans of a run that are kept, at most."""
REPLAYED = 60_000
"""Scans of all runs of a page that are replayed, at most."""
SCALE = 1e-4
"""Of a score as a 16-bit integer."""
BELOW, PASSED, REFUSED, CHOSEN, UNDEFINED = range(5)
"""What became of a candidate: not chosen by the selector, or chosen, but another was accepted
before it; refused by check or backend; the model scan; without a score."""
MATCHED = ("registered", "fallback")


@dataclass(frozen=True, eq=False)
class Plugins:
    selector: Selector
    similarity: Similarity | None
    guess: Guess | None
    described: Any
    notes: list[str]


def choices(track: Track, scans: Scans, trust: bool) -> dict[str, Any]:
    """A run's choices, packed. Raises ``DataError`` where they cannot be replayed."""
    config = reading.settings_of(track.run, trust)
    if track.run.choices.get("selector") in (None, "none"):
        raise DataError("a whole system chooses no model scans")
    if len(scans.light) != len(track):
        raise DataError(f"{len(scans.light)} scans for {len(track)} poses")
    plugins = _plugins(replicate.with_moved(config, scans.dataset), scans)
    nodes = _nodes(track, scans, plugins)
    out = _replay(track, scans, plugins, nodes)
    motions = _guesses(track, scans, plugins, nodes)
    if motions is not None:
        out["guess"] = packed_poses(motions, track.planar)
    return out


def _plugins(config: dict[str, Any], scans: Scans) -> Plugins:
    selector: Selector = assembly.build(config["selector"])
    if selector.covariance_from is not None:
        raise DataError("its choice rests on covariances, which a run does not store")
    similarity, described, notes = None, None, []
    if selector.needs_scores:
        similarity = assembly.build(config["similarity"])
        key = json.dumps(config["similarity"], sort_keys=True)
        described = reading.described(scans, similarity, key)
    guess: Guess | None = assembly.build(config["guess"])
    assert guess is not None
    if guess.needs_backend:
        notes.append("the initial guess is a registration of its own, which a run does not store")
        if similarity is not None and similarity.needs_guess:
            raise DataError("its similarity rests on the initial guess, which a run does not store")
        guess = None
    elif "NoSearch" not in str(config["search"]["_target_"]):
        notes.append("a search comes between the initial guess and the backend")
    return Plugins(selector, similarity, guess, described, notes)


def _nodes(track: Track, scans: Scans, plugins: Plugins) -> list[Node]:
    models, hops = track.models, np.zeros(len(track), np.int64)
    nodes = []
    for i, scan in enumerate(scans.light):
        hops[i] = hops[models[i]] + 1 if models[i] >= 0 else (hops[i - 1] + 1 if i else 0)
        one = None if plugins.described is None else plugins.described[i]
        T = track.T_world_scan[i]
        nodes.append(Node(i, scan.stamp, T, scan.odometry, None, one, int(hops[i])))
    return nodes


def _replay(track: Track, scans: Scans, plugins: Plugins, nodes: list[Node]) -> dict[str, Any]:
    selector, steps = plugins.selector, track.steps
    window = selector.window()
    every = 1 + len(track) * selector.capacity // CELLS
    gaps: list[Any] = []
    scores: list[Any] = []
    fates: list[Any] = []
    counts = np.zeros(len(track), np.int64)
    others = 0
    for j in range(len(nodes)):
        status = str(steps["status"][j])
        if selector.needs_truth or selector.needs_scans:
            scan = scans.dataset[j]
            selector.see(scan if selector.needs_truth else scan.without_truth())
        if j and len(window) and status not in ("still", "unusable"):
            own, selection = _selection(j, window, nodes, scans, plugins)
            fate, agrees = _fates(j, window, own, selection, track)
            others += not agrees
            if j % every == 0:
                counts[j] = len(window)
                gaps.append(j - window.scans)
                scores.append(own.copy())
                fates.append(fate)
        _remember(j, window, nodes, track, selector)
    joined = [np.concatenate(rows) if rows else np.zeros(0) for rows in (gaps, scores, fates)]
    whole = np.where(np.isfinite(joined[1]), np.round(joined[1] / SCALE), MISSING)
    return {
        "counts": packed(counts, "i16"),
        "gaps": packed(np.clip(joined[0], 0, 32767), "i16", 1),
        "scores": packed(whole, "i16", 1),
        "fates": packed(joined[2], "u8"),
        "scored": selector.needs_scores,
        "triesAll": selector.tries_all,
        "threshold": getattr(selector, "threshold", None),
        "fallback": selector.fallback,
        "window": selector.capacity + 1,
        "every": every,
        "others": others,
        "notes": plugins.notes,
    }


def _selection(
    j: int, window: Window, nodes: list[Node], scans: Scans, plugins: Plugins
) -> tuple[Array, Selection]:
    similarity, node = plugins.similarity, nodes[j]
    scores = np.full(len(window), np.nan)
    if similarity is not None and node.descriptor is not None:
        if similarity.needs_guess:
            recent = nodes[max(0, j - 2) : j]
            assert plugins.guess is not None
            motions = [plugins.guess.predict(n, scans.light[j], recent) for n in window.nodes]
            scores = similarity.scores_under(window.descriptors, node.descriptor, np.stack(motions))
        else:
            scores = similarity.scores(window.descriptors, node.descriptor)
    return scores, plugins.selector.choose(j, window, scores)


def _fates(
    j: int, window: Window, scores: Array, selection: Selection, track: Track
) -> tuple[Array, bool]:
    """What became of every member, and whether that is what the run stored."""
    steps, model = track.steps, track.models[j]
    fates = np.full(len(window), BELOW)
    if np.isfinite(scores).any():
        fates[np.isnan(scores)] = UNDEFINED
    accepted, left = steps["status"][j] in MATCHED and not steps["restart"][j], steps["rejected"][j]
    met = False
    for candidate in selection.candidates:
        at = window.position(candidate.model)
        if accepted and candidate.model == model:
            fates[at], met = CHOSEN, True
        elif left and not met:
            fates[at], left = REFUSED, left - 1
        elif not candidate.is_fallback:
            fates[at] = PASSED
    return fates, met or not accepted


def _remember(j: int, window: Window, nodes: list[Node], track: Track, selector: Selector) -> None:
    """What the loop pushes into the window after scan j (odometry/loop.py)."""
    status = track.steps["status"][j]
    if track.steps["restart"][j]:
        window.push(nodes[j - 1], always=True)
    lost = j > 0 and status not in (*MATCHED, "still") and len(window) > 0
    lost = lost and (status == "skipped" or selector.fallback == "skip")
    if status not in ("still", "unusable") and not lost:
        window.push(nodes[j])


def _guesses(track: Track, scans: Scans, plugins: Plugins, nodes: list[Node]) -> Array | None:
    """T_model_scan (N, 4, 4) as it was guessed, from the stored poses."""
    if plugins.guess is None:
        return None
    models = track.models
    motions = np.tile(np.eye(4), (len(track), 1, 1))
    for j in range(1, len(track)):
        model = models[j] if models[j] >= 0 else j - 1
        recent = nodes[max(0, j - 2) : j]
        motions[j] = plugins.guess.predict(nodes[model], scans.light[j], recent)
    return motions
