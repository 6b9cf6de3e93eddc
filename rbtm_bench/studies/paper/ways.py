"""The rows of Table I that scripts/reproduce_paper.py makes, and the tries that each of them gets.

Lengths are in cm of travel, so that another number of scans means the same distances.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rbtm_bench.core.wording import shown

PATH_CM = 180.0
"""The paper's path."""
NOISE_MM = 10.0
"""Of Table I's rows with noise, standard deviation of a range."""


@dataclass(frozen=True)
class PaperWay:
    """A row of Table I. Its ``values`` of ``knob`` are the settings that it may choose from."""

    key: str
    words: tuple[str, ...]
    knob: str
    values: tuple[float, ...]
    noise_mm: float = NOISE_MM

    @property
    def name(self) -> str:
        """For a row of a table."""
        return NAMES[self.key][0]

    def tried(self, k: int) -> str:
        """The ``k``-th try as an override."""
        return f"{self.knob}={shown(self.values[k])}"

    def setting(self, k: int) -> str:
        """The same in words: "window 64, threshold 0.5"."""
        text = KNOBS[self.knob][0].format(f"{self.values[k]:g}")
        window = next((w.partition("=")[2] for w in self.words if "window=" in w), None)
        text = f"window {window}, {text}" if window else text
        return f"gaps of RBTM, {text}" if self.key == "random_gap" else text

    def brief(self, k: int) -> str:
        """The same for a narrow column, without the window that all of RBTM share: "Th 0.5"."""
        text = KNOBS[self.knob][1].format(f"{self.values[k]:g}")
        return f"gaps of {text}" if self.key == "random_gap" else text


NAMES = {
    "standard": ("standard ICP (previous scan)", "standard"),
    "literal": ("RBTM, paper's descriptor", "RBTM, paper's"),
    "circular": ("RBTM, circular descriptor", "RBTM, circular"),
    "fixed_gap": ("control: fixed gap", "fixed gap"),
    "keyframe": ("control: last keyframe", "last keyframe"),
    "oldest": ("control: oldest of window", "oldest"),
    "random_gap": ("control: random gap", "random gap"),
    "standard_clean": ("no noise: standard ICP", "no noise: standard"),
    "literal_clean": ("no noise: RBTM, paper's descr.", "no noise: RBTM, paper's"),
}
"""Of a row of Table I, and the same above a narrow column."""

KNOBS = {
    "registration.max_correspondence_distance": ("ICP distance {} m", "ICP {} m"),
    "selector.threshold": ("threshold {}", "Th {}"),
    "selector.gap": ("gap {} scans", "gap {}"),
    "selector.distance": ("keyframe every {} m", "every {} m"),
    "selector.window": ("window {} scans", "window {}"),
}
"""What is tried, in words and in few of them."""


def make_ways(scans: int) -> dict[str, PaperWay]:
    """The rows of Table I for so many scans on the path, by key; four tries each."""
    window = f"selector.window={window_of(64, scans)}"
    rbtm = ("selector=rbtm", window)
    literal = (*rbtm, "similarity=curvature")
    gaps = _distinct(gap_of(cm, scans) for cm in (5, 10, 20, 40))
    windows = _distinct(window_of(cm, scans) for cm in (8, 16, 32, 64))
    # The standard way has nothing of its own to choose, so it gets its ICP's distance.
    distance = ("registration.max_correspondence_distance", (0.1, 0.2, 0.3, 0.5))
    low = ("selector.threshold", (0.2, 0.3, 0.4, 0.5))  # its scores stay below 0.8
    high = ("selector.threshold", (0.5, 0.6, 0.7, 0.8))
    metres = ("selector.distance", (0.1, 0.2, 0.3, 0.5))
    ways = (
        PaperWay("standard", ("selector=previous",), *distance),
        PaperWay("literal", literal, *low),
        PaperWay("circular", rbtm, *high),
        PaperWay("fixed_gap", ("selector=fixed_gap",), "selector.gap", gaps),
        PaperWay("keyframe", ("selector=keyframe",), *metres),
        PaperWay("oldest", ("selector=oldest",), "selector.window", windows),
        # its tries are those of "circular", whose gaps it draws
        PaperWay("random_gap", ("selector=rbtm,random_gap", window), *high),
        PaperWay("standard_clean", ("selector=previous",), *distance, 0.0),
        PaperWay("literal_clean", literal, *low, 0.0),
    )
    return {way.key: way for way in ways}


def gap_of(cm: float, scans: int) -> int:
    """A gap in scans for a distance travelled."""
    return max(1, round(cm * (scans - 1) / PATH_CM))


def window_of(cm: float, scans: int) -> int:
    """A window in scans; it counts the new scan, so two at least."""
    return max(2, round(cm * (scans - 1) / PATH_CM))


def _distinct(ascending: Iterable[int]) -> tuple[float, ...]:
    """The numbers, with few scans on the path as far apart as makes them different tries."""
    distinct: list[float] = []
    for value in ascending:
        distinct.append(max(value, distinct[-1] + 1) if distinct else value)
    return tuple(distinct)
