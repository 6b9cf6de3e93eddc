"""2D scans in 3D libraries: normals and covariances made in the plane.

Points of one plane have a normal out of that plane for a PCA on 3D neighbours: point-to-plane
then returns its guess, and generalized ICP turns into point-to-point. Every backend that needs
normals or covariances takes them from this module for planar scans; a library that makes its own
and takes none gets the scan in two layers instead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.backends.neighbours_2d import Sorted2D, sorted_2d
from rbtm_bench.core.kernels import kernel
from rbtm_bench.core.types import Array

MIN_NEIGHBOURS = 5
LAYER_HEIGHT = 0.3
"""m above and below the plane, beyond the spread of neighbours across a wall. Where neighbours
spread farther both ways, they are no wall, and a PCA lays their normal upright: no direction."""


def normals_2d(points: Array, radius: float, max_neighbours: int) -> Array:
    """Unit normals (N, 3) with z = 0 of planar points (N, 3).

    The direction of least spread among the neighbours within ``radius`` m, at most
    ``max_neighbours`` and at least the 5 nearest (whatever their distance), the point included.
    """
    ordered = sorted_2d(points)
    normals = np.empty((len(points), 3))
    normals[ordered.original] = _normals(ordered, radius, max_neighbours)
    return normals


@kernel
def _normals(points: Sorted2D, radius: float, max_neighbours: int) -> Array:
    """What ``normals_2d`` says, in the order of sorted points."""
    normals = np.zeros((len(points.xy), 3))
    squares = np.empty(max_neighbours)
    places = np.empty(max_neighbours, np.int64)
    for place in range(len(points.xy)):
        count = _nearest(points, place, radius, squares, places)
        mx = my = xx = xy = yy = 0.0
        for k in places[:count]:
            dx = points.xy[k, 0] - points.xy[place, 0]
            dy = points.xy[k, 1] - points.xy[place, 1]
            mx += dx
            my += dy
            xx += dx * dx
            xy += dx * dy
            yy += dy * dy
        xx, xy, yy = xx - mx * mx / count, xy - mx * my / count, yy - my * my / count
        tangent = 0.5 * np.arctan2(2.0 * xy, xx - yy)  # direction of the larger eigenvalue
        normals[place, 0] = -np.sin(tangent)
        normals[place, 1] = np.cos(tangent)
    return normals


@kernel
def _nearest(
    points: Sorted2D, place: int, radius: float, squares: Array, places: NDArray[np.int64]
) -> int:
    """Fill ``squares`` and ``places`` (both (K,)) with the nearest points of one of them, itself
    first: as many as fit within ``radius`` m, and the 5 nearest. Returns how many those are."""
    xy, axis = points.xy, points.axis
    count, up, down = 0, place, place - 1
    while up < len(xy) or down >= 0:
        ahead = np.inf if up >= len(xy) else xy[up, axis] - xy[place, axis]
        behind = np.inf if down < 0 else xy[place, axis] - xy[down, axis]
        reach = min(ahead, behind) ** 2
        if count >= MIN_NEIGHBOURS and reach > max(radius**2, squares[MIN_NEIGHBOURS - 1]):
            break
        if count == len(squares) and reach >= squares[count - 1]:
            break
        other = up if ahead <= behind else down
        if ahead <= behind:
            up += 1
        else:
            down -= 1
        square = (xy[other, 0] - xy[place, 0]) ** 2 + (xy[other, 1] - xy[place, 1]) ** 2
        at = count
        if count == len(squares):
            if square >= squares[count - 1]:
                continue
            at -= 1
        else:
            count += 1
        while at > 0 and squares[at - 1] > square:
            squares[at], places[at] = squares[at - 1], places[at - 1]
            at -= 1
        squares[at], places[at] = square, other
    while count > MIN_NEIGHBOURS and squares[count - 1] > radius**2:
        count -= 1
    return count


def covariances_of_discs(normals: Array, epsilon: float) -> Array:
    """Covariances (N, 3, 3) for generalized ICP: ``epsilon`` along the normal (N, 3), 1 across
    it (Segal et al. 2009); for normals in the plane that is a wall standing upright."""
    outer = normals[:, :, None] * normals[:, None, :]
    return np.eye(3) - (1.0 - epsilon) * outer


def lifted(points: Array, cell_size: float | None = None) -> Array:
    """Planar points (N, 3) twice, as layers (2N, 3) below and above the plane: upright walls.

    A PCA on as many neighbours from one layer as from the other finds the normals of the plane's
    own PCA, exactly in the plane. What pulls one layer out of the plane is opposed by the other,
    so a registration of such scans stays in the plane but for rounding. With ``cell_size`` m the
    layers lie in the middle of cubic cells, one of which is centred on the origin.
    """
    height = LAYER_HEIGHT
    if cell_size is not None:
        height = max(1.0, np.round(LAYER_HEIGHT / cell_size)) * cell_size
    up = np.array([0.0, 0.0, height])
    return np.concatenate([points - up, points + up])
