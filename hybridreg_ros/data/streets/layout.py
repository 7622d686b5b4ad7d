# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Layouts along a centre line: street, car park, park, warehouse, square; nothing twice alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.bodies.track import Track
from hybridreg_ros.data.meshes.geometry import moved, rot_z
from hybridreg_ros.data.meshes.shapes import box
from hybridreg_ros.data.streets import vehicles, vehicles_drive
from hybridreg_ros.data.streets.built import (
    Collection,
    building,
    pole,
    rack,
    street_thing,
    wall,
)
from hybridreg_ros.data.streets.nature import Terrain, bush, hedge, make_terrain, rock, tree

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hybridreg_ros.data.meshes.scene import Mesh

    F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Layout:
    """A static world and where things may move in it; offsets from the centre line, metres.

    Attributes:
        terrain: the ground.
        static: everything on it, ground first.
        ego: lowest and highest offset of the sensor's way.
        lanes: offsets of vehicle lanes, negative = along the centre line, positive = against it.
        walks: lowest and highest offsets of the bands in which people walk.
        stands: bands in which people stay in one place.
        indoor: True under a roof.
    """

    terrain: Terrain
    static: Collection
    ego: tuple[float, float]
    lanes: tuple[float, ...]
    walks: tuple[tuple[float, float], ...]
    stands: tuple[tuple[float, float], ...]
    indoor: bool = False


def centre_line(rng: np.random.Generator, length_m: float, bend: float) -> Track:
    """A gently winding line of a length through the origin; `bend` in radians per 25 m."""
    step = 0.75
    count = int(length_m / step) + 2
    knots = np.cumsum(rng.normal(0.0, bend, int(length_m / 25.0) + 3))
    heading = rng.uniform(0.0, 2.0 * np.pi) + np.interp(
        step * np.arange(count), 25.0 * np.arange(len(knots)), knots
    )
    smooth = np.convolve(np.pad(heading, 8, mode='edge'), np.full(17, 1 / 17), mode='valid')
    steps = step * np.stack([np.cos(smooth), np.sin(smooth)], axis=1)
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return Track(points)


class Builder:
    """Places pieces along a centre line."""

    def __init__(self, rng: np.random.Generator, terrain: Terrain) -> None:
        self.rng, self.terrain, self.made = rng, terrain, Collection()
        self.made.add(terrain.mesh(), plane=1)
        self._planes = 1

    def put(self, mesh: Mesh, s: float, d: float, yaw: float = 0.0) -> None:
        """Stand a mesh at a place, turned against the direction of the centre line."""
        place, heading = self.terrain.at(s, d)
        self.made.add(moved(mesh, place, rot_z(heading + yaw)))

    def scatter(
        self,
        make: Callable[[np.random.Generator], Mesh],
        per_m: float,
        band: tuple[float, float],
        *,
        kinds: int = 6,
    ) -> None:
        """Strew things over a band, `per_m` of them on each metre of the centre line."""
        count = int(self.rng.poisson(per_m * self.terrain.centre.length_m))
        pool = [make(self.rng) for _ in range(min(kinds, count))]
        for _ in range(count):
            mesh = pool[self.rng.integers(len(pool))]
            size = self.rng.uniform(0.8, 1.25, 3)
            self.put(
                moved(mesh, scale=size),
                self.rng.uniform(0.0, self.terrain.centre.length_m),
                self.rng.uniform(*band),
                self.rng.uniform(0.0, 2.0 * np.pi),
            )

    def row(
        self,
        make: Callable[[np.random.Generator], Mesh],
        every: tuple[float, float],
        d: float,
        *,
        keep: float = 1.0,
        yaw: float = 0.0,
        jitter: float = 0.15,
    ) -> None:
        """A row of things at about regular distances."""
        s = self.rng.uniform(0.0, every[1])
        while s < self.terrain.centre.length_m:
            if self.rng.random() < keep:
                self.put(make(self.rng), s, d + self.rng.normal(0.0, jitter), yaw)
            s += self.rng.uniform(*every)

    def line(self, mesh: Mesh, every_m: float, d: float) -> None:
        """The same piece again and again along the centre line."""
        for s in np.arange(0.0, self.terrain.centre.length_m, every_m):
            self.put(mesh, float(s), d)

    def fronts(self, d: float, side: float, *, gap: float = 0.3) -> None:
        """Buildings side by side that face the centre line from an offset d on a side."""
        s = self.rng.uniform(-6.0, 4.0)
        while s < self.terrain.centre.length_m - 4.0:
            length = self.rng.uniform(6.0, 22.0)
            if self.rng.random() > gap:
                start, stop = s + length, s
                if side < 0:
                    start, stop = s, s + length
                away = abs(d) + self.rng.exponential(0.8)
                low, _ = self.terrain.at(start, side * away)
                high, _ = self.terrain.at(stop, side * away)
                run = high[:2] - low[:2]
                heading = float(np.arctan2(run[1], run[0]))
                made = building(self.rng, max(float(np.linalg.norm(run)), 3.0))
                self._planes += 1
                base = np.array([*low[:2], min(low[2], high[2]) - 0.05])
                # The front faces +y: the run goes so that +y points to the centre line.
                self.made.placed(made, base, heading, plane=self._planes)
            s += length + self.rng.uniform(0.0, 5.0)

    def border(self, d: float, side: float, *, keep: float = 0.75) -> None:
        """Fences, walls and hedges with gaps along a side."""
        s = 0.0
        while s < self.terrain.centre.length_m:
            length = self.rng.uniform(3.0, 9.0)
            if self.rng.random() < keep:
                make = hedge if self.rng.random() < 0.35 else wall
                self.put(make(self.rng, length), s, side * d)
            s += length + self.rng.uniform(0.3, 3.0)

    def cars(self, d: float, *, keep: float, across: bool) -> None:
        """Parked vehicles along or across the centre line."""
        s = self.rng.uniform(0.0, 4.0)
        kinds = ('car', 'van', 'lorry')
        pool = [
            vehicles.make_vehicle(self.rng, str(self.rng.choice(kinds, p=[0.8, 0.17, 0.03])))
            for _ in range(10)
        ]
        while s < self.terrain.centre.length_m:
            mesh = pool[self.rng.integers(len(pool))]
            size = np.ptp(mesh.vertices, axis=0)
            need = size[1] if across else size[0]
            if self.rng.random() < keep and not (across and size[0] > 6.0):
                place, heading = self.terrain.at(s + 0.5 * need, d + self.rng.normal(0.0, 0.15))
                turn = 0.5 * np.pi if across else 0.0
                yaw = heading + turn + np.pi * self.rng.integers(2)
                self.made.add(
                    vehicles_drive.parked(self.rng, mesh, place[:2], yaw, self.terrain.height)
                )
            s += (max(need, 2.1) if across else need) + self.rng.uniform(0.4, 1.6)


def street(rng: np.random.Generator, length_m: float) -> Layout:
    """Two lanes, parked cars, pavements, gardens or shops, side streets."""
    half, park, walk_w = rng.uniform(2.6, 4.2), rng.uniform(2.0, 2.4), rng.uniform(1.6, 4.0)
    park = park if rng.random() < 0.7 else 0.0
    kerb, garden = half + park, float(rng.choice([0.0, rng.uniform(2.0, 8.0)]))
    step, end = rng.uniform(0.06, 0.16), half + park + walk_w
    slope = rng.uniform(0.01, 0.03)
    side = [(kerb, -slope * kerb), (kerb + 0.04, step), (end, step + 0.02), (end + 30, 0.4)]
    profile = [(-d, z) for d, z in reversed(side)] + [(0.0, 0.0)] + side
    line = centre_line(rng, length_m, rng.uniform(0.02, 0.12))
    b = Builder(rng, make_terrain(rng, line, profile))
    for sign in (1.0, -1.0):
        if park:
            b.cars(sign * (half + 0.5 * park), keep=rng.uniform(0.2, 0.9), across=False)
        b.row(pole, (6.0, 28.0), sign * (kerb + 0.35), keep=0.9)
        b.row(street_thing, (9.0, 40.0), sign * (kerb + 0.6), keep=0.7)
        if rng.random() < 0.55:
            b.row(tree, (6.0, 18.0), sign * (kerb + 0.6), keep=0.8)
        if garden:
            b.border(end + 0.2, sign)
            b.scatter(bush, 0.12, on_side(sign, end + 0.6, end + garden))
            b.scatter(tree, 0.04, on_side(sign, end + 1.0, end + garden))
        b.fronts(end + garden + 0.1, sign, gap=rng.uniform(0.05, 0.35))
        b.scatter(tree, 0.05, on_side(sign, end + garden + 12, end + garden + 25))
    walks = ((kerb + 0.9, end - 0.3), (-end + 0.3, -kerb - 0.9))
    ego = (-0.5 * half - 0.3, -0.5 * half + 0.3)
    if rng.random() < 0.25:
        ego = (kerb + 0.9, max(end - 0.6, kerb + 1.0))
    lanes = (-0.5 * half - 0.1, 0.5 * half + 0.1)
    return Layout(b.terrain, b.made, ego, lanes, walks, walks)


def on_side(sign: float, near: float, far: float) -> tuple[float, float]:
    """Lowest and highest offset of a band on the left (sign 1) or right (-1) side."""
    return (near, far) if sign > 0 else (-far, -near)


def car_park(rng: np.random.Generator, length_m: float) -> Layout:
    """Aisles between rows of cars parked across, lamp posts, trees, something built around."""
    aisle, deep = rng.uniform(2.8, 3.6), 5.2
    profile = [(-60, 0.6), (-22, 0.1), (0, 0), (22, 0.1), (60, 0.6)]
    line = centre_line(rng, length_m, rng.uniform(0.0, 0.03))
    b = Builder(rng, make_terrain(rng, line, profile, wild=0.5))
    for sign in (1.0, -1.0):
        keep = rng.uniform(0.3, 0.9)
        b.cars(sign * (aisle + 0.5 * deep), keep=keep, across=True)
        row = aisle + deep + rng.uniform(0.5, 2.5)
        b.cars(sign * (row + 0.5 * deep), keep=keep, across=True)
        b.row(pole, (10.0, 30.0), sign * (aisle + deep + 0.3))
        b.row(tree, (7.0, 25.0), sign * (aisle + deep + 0.4), keep=0.5)
        edge = row + deep + rng.uniform(1.0, 8.0)
        b.border(edge, sign)
        b.scatter(bush, 0.15, on_side(sign, edge, edge + 2.0))
        b.scatter(tree, 0.1, on_side(sign, edge, edge + 12.0))
        b.fronts(edge + 4.0 + rng.exponential(6.0), sign, gap=0.5)
        b.scatter(street_thing, 0.03, on_side(sign, aisle + deep, row))
    walks = ((0.9, aisle - 0.3), (-aisle + 0.3, -0.9))
    return Layout(b.terrain, b.made, (-0.5, 0.5), (-1.2, 1.6), walks, walks)


def park(rng: np.random.Generator, length_m: float) -> Layout:
    """A path through grass, trees, bushes, benches, rocks, now and then a house or a wall."""
    path = rng.uniform(1.2, 2.8)
    profile = [
        (-60, rng.uniform(-1, 3)),
        (-9, 0.1),
        (-path, 0.03),
        (path, 0.03),
        (9, 0.1),
        (60, rng.uniform(-1, 3)),
    ]
    line = centre_line(rng, length_m, rng.uniform(0.05, 0.2))
    b = Builder(rng, make_terrain(rng, line, profile, wild=rng.uniform(1.0, 2.2)))
    for sign in (1.0, -1.0):
        b.scatter(tree, rng.uniform(0.15, 0.5), on_side(sign, path + 3.5, 32.0))
        b.scatter(bush, rng.uniform(0.15, 0.5), on_side(sign, path + 3.5, 30.0))
        b.scatter(rock, 0.06, on_side(sign, path + 3.0, 25.0))
        b.row(street_thing, (10.0, 40.0), sign * (path + 0.7), keep=0.7)
        b.row(pole, (15.0, 40.0), sign * (path + 0.4), keep=0.6)
        if rng.random() < 0.4:
            b.border(path + rng.uniform(4.0, 15.0), sign, keep=0.5)
        if rng.random() < 0.4:
            b.fronts(rng.uniform(14.0, 30.0), sign, gap=0.75)
    walks = ((0.8, path + 2.6), (-path - 2.6, -0.8))
    return Layout(b.terrain, b.made, (-0.4, 0.4), (), walks, walks)


def warehouse(rng: np.random.Generator, length_m: float) -> Layout:
    """Aisles between pallet racks under a roof, with columns, pallets and machines."""
    aisle, deep = rng.uniform(1.7, 3.2), 1.2
    line = centre_line(rng, length_m, 0.0)
    b = Builder(rng, make_terrain(rng, line, [(-60, 0), (60, 0)], wild=0.15))
    outer = float(rng.uniform(2.5, 5.0))
    rows = np.cumsum([aisle + 0.5 * deep, deep + rng.uniform(0.1, 0.6), deep + outer])
    for sign in (1.0, -1.0):
        for d in rows[: int(rng.integers(1, 4))]:
            s = rng.uniform(0.0, 3.0)
            while s < line.length_m - 3.0:
                length = rng.uniform(4.0, 14.0)
                if rng.random() < 0.85:
                    b.put(rack(rng, length), s, sign * d)
                s += length + rng.uniform(0.5, 4.0)
        b.row(
            lambda r: box((0.3, 0.3, 9.0), (0, 0, 4.5)), (6.0, 8.0), sign * (aisle + 0.2), keep=0.7
        )
        b.row(street_thing, (5.0, 25.0), sign * (rows[-1] + 1.5), keep=0.8)
        end = rows[-1] + rng.uniform(3.0, 9.0)
        for s in np.arange(0.0, line.length_m, 5.0):
            b.put(box((5.0, 0.3, 8.0), (2.5, 0.0, 4.0)), float(s), sign * end)
    roof = rng.uniform(5.0, 9.0)
    for s in np.arange(0.0, line.length_m, rng.uniform(4.0, 7.0)):
        b.put(box((0.3, 50.0, 0.5), (0.0, 0.0, roof)), float(s), 0.0)
        for d in rng.uniform(-10.0, 10.0, 3):
            b.put(box((1.4, 0.3, 0.12), (0.0, 0.0, roof - 0.8)), float(s) + 1.0, float(d))
    b.put(box((line.length_m, 50.0, 0.2), (0.5 * line.length_m, 0.0, roof + 0.4)), 0.0, 0.0)
    for s in (0.0, line.length_m):
        b.put(box((0.3, 2.4 * rows[-1] + 10, 8.0), (0.0, 0.0, 4.0)), s, 0.0)
    walks = ((0.6, aisle - 0.4), (-aisle + 0.4, -0.6))
    return Layout(b.terrain, b.made, (-0.3, 0.3), (-0.3,), walks, walks, indoor=True)


def square(rng: np.random.Generator, length_m: float) -> Layout:
    """An open square or campus: paving, planters, trees, kiosks, fronts on two sides."""
    wide = rng.uniform(7.0, 20.0)
    profile = [(-60, 0.2), (-wide, 0.05), (0, 0), (wide, 0.05), (60, 0.2)]
    line = centre_line(rng, length_m, rng.uniform(0.02, 0.15))
    b = Builder(rng, make_terrain(rng, line, profile, wild=0.6))
    for sign in (1.0, -1.0):
        b.scatter(street_thing, rng.uniform(0.1, 0.3), on_side(sign, 5.5, wide))
        b.scatter(tree, rng.uniform(0.03, 0.12), on_side(sign, 6.0, wide))
        b.scatter(pole, 0.08, on_side(sign, 5.5, wide))
        b.scatter(bush, 0.05, on_side(sign, 6.0, wide))
        b.scatter(rock, 0.03, on_side(sign, 6.0, wide))
        b.fronts(wide + rng.uniform(0.5, 4.0), sign, gap=rng.uniform(0.1, 0.5))
    walks = ((0.8, 5.0), (-5.0, -0.8))
    return Layout(b.terrain, b.made, (-0.5, 0.5), (), walks, walks)


LAYOUTS: dict[str, Callable[[np.random.Generator, float], Layout]] = {
    'street': street,
    'car_park': car_park,
    'park': park,
    'warehouse': warehouse,
    'square': square,
}
