"""The simulated places in space: a street, a tunnel, an office floor and a hall. All in metres.

The ground is z = 0. Each place but the hall is furnished by chance, from ``layout`` alone, so that
nothing in it repeats at equal distances.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from rbtm_bench.core.types import Array
from rbtm_bench.datasets.circuit import Circuit, Place, block, placed, slab
from rbtm_bench.datasets.raycast import Mesh, box_mesh, merge, pillar_mesh, walls_mesh

Rng = np.random.Generator

# Round a block of houses, anticlockwise. Seen from the car along one of the four straights:
#
#        house    | house |      house          +7 .. +15   (the inner side: the block itself)
#         [car]        [car]  [car]             +4.4
#      o - - - - - - - - - - - - - - - ->        0
#       [car]  [car]        [car]               -4.4
#     .          .         .          .  poles  -5.9
#     house   |   house |  gap  | house         -7 .. -15
STREET_LONG, STREET_SHORT, STREET_RADIUS = 60.0, 36.0, 8.0
FRONT, HOUSE_DEPTH, KERB = 7.0, 8.0, 5.4


def street(layout: int) -> Place:
    """Houses with gaps and porches, parked cars, poles and kerbs along four straights."""
    way = block(STREET_LONG, STREET_SHORT, STREET_RADIUS)
    rng = np.random.default_rng([layout, 0])
    parts = [slab((-60.0, -50.0), (120.0, 100.0), 0.0)]
    for start, (length, _) in zip(way.starts[::2], way.pieces[::2], strict=True):
        inside = (FRONT - STREET_RADIUS, length + STREET_RADIUS - FRONT)
        outside = (-STREET_RADIUS - FRONT, length + STREET_RADIUS + FRONT)
        side = [*houses(rng, *inside, +1), *houses(rng, *outside, -1)]
        side += [*cars(rng, length, +1), *cars(rng, length, -1)]
        side += [*poles(rng, length), kerb(length, +1), kerb(length, -1)]
        parts.append(placed(side, start))
    return Place(merge(parts), way, height=1.8, step=0.8)


def houses(rng: Rng, x0: float, x1: float, side: int) -> Iterator[Mesh]:
    """Fronts along x, set back by up to 0.8 m, some with a porch; now and then a gap."""
    x = x0
    while x < x1 - 2.0:
        width = min(rng.uniform(6.0, 13.0), x1 - x)
        front = FRONT + rng.uniform(0.0, 0.8)
        top = rng.uniform(5.0, 12.0)
        yield _box(x, x + width, side * front, side * (FRONT + HOUSE_DEPTH), 0.0, top)
        if width > 4.0:
            door = x + rng.uniform(0.5, width - 2.0)
            yield _box(door, door + 1.3, side * (front - 0.6), side * front, 0.0, 2.4)
        x += width + (rng.uniform(2.0, 5.0) if rng.random() < 0.35 else 0.0)


def cars(rng: Rng, length: float, side: int) -> Iterator[Mesh]:
    """Parked cars: a body and a cabin each, in six places out of ten."""
    for slot in np.arange(2.0, length - 5.0, 6.5):
        if rng.random() < 0.6:
            x = slot + rng.uniform(-0.5, 0.5)
            y = side * (4.4 + rng.uniform(-0.15, 0.15))
            long, half = rng.uniform(3.8, 4.8), rng.uniform(0.82, 0.95)
            top = rng.uniform(1.4, 1.8)
            yield _box(x, x + long, y - half, y + half, 0.25, 0.9)
            yield _box(x + 0.25 * long, x + 0.8 * long, y - 0.9 * half, y + 0.9 * half, 0.9, top)


def poles(rng: Rng, length: float) -> Iterator[Mesh]:
    """Lamps on the outer pavement, about every 14 m."""
    for x in np.arange(3.0, length, 14.0):
        yield pillar_mesh((x + rng.uniform(-2.0, 2.0), -5.9), 0.12, 0.0, 6.0, sides=12)


def kerb(length: float, side: int) -> Mesh:
    """The edge of the pavement."""
    return _box(0.0, length, side * KERB, side * (KERB + 0.2), 0.0, 0.14)


# Two straights and two half circles. Across:
#
#          ______
#         /      \      5.0
#        |        |     2.6
#     [__|        |     recesses of 1.2 m, left and right, at uneven distances
#     -4 ____o_____ +4
TUNNEL_STRAIGHT, TUNNEL_RADIUS, TUNNEL_HALF = 70.0, 25.0, 4.0
RECESS_DEPTH = 1.2
ARCH = ((4.0, 0.0), (4.0, 2.6), (3.0, 4.3), (1.2, 5.0), (-1.2, 5.0), (-3.0, 4.3), (-4.0, 2.6),
        (-4.0, 0.0))  # fmt: skip


def tunnel(layout: int) -> Place:
    """An arched tube with recesses and cabinets, alike elsewhere: hard along its axis."""
    half_circle = (np.pi * TUNNEL_RADIUS, 1.0 / TUNNEL_RADIUS)
    way = Circuit(((TUNNEL_STRAIGHT, 0.0), half_circle) * 2)
    rng = np.random.default_rng([layout, 1])
    recesses, cabinets = [], []
    x = rng.uniform(4.0, 10.0)
    while x < way.length - 6.0:
        side = 1 if rng.random() < 0.5 else -1
        recesses.append((x, x + rng.uniform(2.0, 4.5), side))
        y = -side * TUNNEL_HALF
        cabinet = _box(-0.4, 0.4, y + side * rng.uniform(0.3, 0.5), y, 0.0, rng.uniform(1.2, 2.0))
        cabinets.append(placed([cabinet], way.poses([x + rng.uniform(-2.0, 4.0)])[0]))
        x += rng.uniform(9.0, 22.0)
    return Place(merge([_tube(way, recesses), *cabinets]), way, height=1.6, step=0.8)


def _tube(way: Circuit, recesses: list[tuple[float, float, int]]) -> Mesh:
    """The arch swept along the way; where there is a recess its foot stands farther out."""
    edges = [at + d for a, b, _ in recesses for at in (a, b) for d in (-0.01, 0.01)]
    stations = np.unique([*np.arange(0.0, way.length, 1.0), *edges])
    arch = np.array(ARCH)
    sections = np.zeros((len(stations), len(arch), 3))
    sections[:, :, 1:] = arch
    for start, end, side in recesses:
        within = np.flatnonzero((stations > start) & (stations < end))
        foot = np.flatnonzero((arch[:, 1] < 3.0) & (np.sign(arch[:, 0]) == side))
        sections[within[:, None], foot, 1] += side * RECESS_DEPTH
    poses = way.poses(stations)
    points = np.einsum("sij,snj->sni", poses[:, :3, :3], sections) + poses[:, None, :3, 3]
    s, n = np.meshgrid(np.arange(len(stations)), np.arange(len(arch)), indexing="ij")
    nexts, across = (s + 1) % len(stations), (n + 1) % len(arch)
    corners = [a * len(arch) + b for a, b in ((s, n), (nexts, n), (nexts, across), (s, across))]
    a, b, c, d = (corner.ravel() for corner in corners)
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Mesh(points.reshape(-1, 3), triangles)


# A corridor round a core, 2.4 m wide, with rooms behind open doors on both sides:
#
#      |      |        |     |
#      |_  ___|__  ____|_  __|     +1.2
#      o - - - - - - - - - - ->     0
#      ___  ______  _____  ___     -1.2
#      |       |        |    |
#      |  desk |  desk  |    |     -6.2
OFFICE_LONG, OFFICE_SHORT, OFFICE_RADIUS = 24.0, 12.0, 1.0
CORRIDOR_HALF, ROOM_DEPTH, CEILING, DOOR_TOP = 1.2, 5.0, 2.8, 2.1


def office(layout: int) -> Place:
    """Rooms with doors, desks, chairs and shelves along a corridor that turns four times."""
    way = block(OFFICE_LONG, OFFICE_SHORT, OFFICE_RADIUS)
    rng = np.random.default_rng([layout, 2])
    low, high = (-9.0, -8.0), (OFFICE_LONG + 9.0, OFFICE_SHORT + 10.0)
    parts = [slab(low, high, 0.0), slab(low, high, CEILING)]
    inset = CORRIDOR_HALF - OFFICE_RADIUS
    for start, (length, _) in zip(way.starts[::2], way.pieces[::2], strict=True):
        outside = -OFFICE_RADIUS - CORRIDOR_HALF, length + OFFICE_RADIUS + CORRIDOR_HALF
        side = list(rooms(rng, *outside, -1))
        if length == OFFICE_LONG:  # the core has rooms along its long sides alone
            side += rooms(rng, inset, length - inset, +1)
        else:
            side.append(_wall(inset, CORRIDOR_HALF, length - inset, CORRIDOR_HALF))
        parts.append(placed(side, start))
    return Place(merge(parts), way, height=1.2, step=0.15)


def rooms(rng: Rng, x0: float, x1: float, side: int) -> Iterator[Mesh]:
    """Rooms side by side, their fronts on the corridor's wall."""
    front, back = side * CORRIDOR_HALF, side * (CORRIDOR_HALF + ROOM_DEPTH)
    yield _wall(x0, back, x1, back)
    count = max(1, round((x1 - x0) / 4.5))
    inner = np.linspace(x0, x1, count + 1)[1:-1] + rng.uniform(-0.5, 0.5, count - 1)
    bounds = [x0, *inner, x1]
    yield _wall(x0, front, x0, back)
    for left, right in pairwise(bounds):
        door = rng.uniform(left + 0.3, right - 1.3)
        yield _wall(left, front, door, front)
        yield _wall(door + 1.0, front, right, front)
        yield walls_mesh([[(door, front), (door + 1.0, front)]], DOOR_TOP, CEILING)
        yield _wall(right, front, right, back)
        yield from furniture(rng, left, right, side)


def furniture(rng: Rng, left: float, right: float, side: int) -> Iterator[Mesh]:
    """Two desks with a chair each, a shelf at the back, now and then a cabinet outside."""
    for y in (1.6, 3.4):
        near = side * (CORRIDOR_HALF + y + rng.uniform(-0.2, 0.2))
        x = rng.uniform(left + 0.1, right - 1.8)
        yield _box(x, x + 1.6, near, near + side * 0.8, 0.70, 0.74)
        yield _box(x, x + 0.4, near, near + side * 0.7, 0.0, 0.70)
        chair = (x + rng.uniform(0.6, 1.3), near - side * 0.4)
        yield pillar_mesh(chair, 0.25, 0.0, rng.uniform(0.5, 1.0), sides=12)
    back = side * (CORRIDOR_HALF + ROOM_DEPTH)
    x = rng.uniform(left + 0.1, right - 1.3)
    yield _box(x, x + 1.2, back - side * 0.4, back, 0.0, rng.uniform(1.4, 2.2))
    if rng.random() < 0.3:
        front = side * CORRIDOR_HALF
        yield _box(left + 0.1, left + 0.7, front - side * 0.35, front, 0.0, 1.6)


def hall(layout: int) -> Place:
    """A hall of 30 m x 20 m x 6 m with boxes and pillars, always the same, driven in a circle."""
    boxes = [
        ((-15.0, -10.0, 0.0), (15.0, 10.0, 6.0)),
        ((-12.5, 6.0, 0.0), (-9.0, 8.5, 2.0)),
        ((-13.5, -7.0, 0.0), (-11.5, -4.0, 3.0)),
        ((-6.0, -9.0, 0.0), (-2.5, -7.5, 1.5)),
        ((3.0, 7.0, 0.0), (6.5, 9.0, 2.5)),
        ((8.5, -3.0, 0.0), (10.0, 0.5, 1.2)),
        ((11.0, 3.5, 0.0), (13.5, 5.0, 4.0)),
        ((5.5, -8.5, 0.0), (8.0, -7.0, 0.8)),
        ((-1.5, -0.8, 0.0), (1.0, 1.2, 1.6)),
    ]
    pillars = [(-8.0, 2.0), (-8.0, -2.5), (0.0, 7.5), (7.5, 5.5), (7.0, -5.0), (1.5, -2.2)]
    parts = [box_mesh(low, high) for low, high in boxes]
    parts += [pillar_mesh(center, 0.3, 0.0, 6.0) for center in pillars]
    way = Circuit(((2.0 * np.pi * 5.0, 1.0 / 5.0),), start=(0.0, -5.0))
    return Place(merge(parts), way, height=1.2, step=0.15)


def _box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> Mesh:
    low: Array = np.array([min(x0, x1), min(y0, y1), z0])
    return box_mesh(low, [max(x0, x1), max(y0, y1), z1])


def _wall(x0: float, y0: float, x1: float, y1: float) -> Mesh:
    return walls_mesh([[(x0, y0), (x1, y1)]], 0.0, CEILING)


PLACES = {"street": street, "tunnel": tunnel, "office": office, "hall": hall}
