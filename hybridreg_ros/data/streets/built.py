# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is built: fronts with windows, doors, balconies; roofs, walls, poles, pallet racks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.meshes.geometry import moved, rot_z
from hybridreg_ros.data.meshes.scene import Mesh, merge
from hybridreg_ros.data.meshes.shapes import box, cylinder, frame, grid, tube

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    F64 = NDArray[np.float64]

GLASS = 0.85
_UNIT = box((1.0, 1.0, 1.0))


def boxes(sizes: ArrayLike, centres: ArrayLike) -> Mesh:
    """Many axis-aligned boxes of sizes (N, 3) about centres (N, 3), metres."""
    size, centre = np.atleast_2d(sizes), np.atleast_2d(centres)
    vertices = _UNIT.vertices * size[:, None].astype(np.float32)
    vertices = vertices + centre[:, None].astype(np.float32)
    start = len(_UNIT.vertices) * np.arange(len(size))[:, None, None]
    faces = (_UNIT.faces + start).reshape(-1, 3).astype(np.int32)
    return Mesh(vertices.reshape(-1, 3).astype(np.float32), faces)


@dataclass
class Collection:
    """Static pieces gathered for one mesh, with what the sensor needs to know of each triangle.

    Attributes:
        meshes: the pieces, world frame.
        loss: share of lost rays of each piece.
        plane: number of the large flat part that each piece belongs to, 0 = none.
    """

    meshes: list[Mesh] = field(default_factory=list)
    loss: list[float] = field(default_factory=list)
    plane: list[int] = field(default_factory=list)

    def add(self, mesh: Mesh, *, loss: float = 0.0, plane: int = 0) -> None:
        """Take a piece."""
        self.meshes.append(mesh)
        self.loss.append(loss)
        self.plane.append(plane)

    def placed(self, other: Collection, place: F64, heading_rad: float, *, plane: int = 0) -> None:
        """Take all pieces of another collection, turned and moved; flat parts become `plane`."""
        R = rot_z(heading_rad)
        for mesh, loss, flat in zip(other.meshes, other.loss, other.plane, strict=True):
            self.add(moved(mesh, place, R), loss=loss, plane=plane if flat else 0)

    def result(self) -> tuple[Mesh, NDArray[np.float32], NDArray[np.int32]]:
        """Merged mesh, loss (F,) and plane (F,) of every triangle."""
        counts = [len(m.faces) for m in self.meshes]
        loss = np.repeat(np.array(self.loss, np.float32), counts)
        return merge(self.meshes), loss, np.repeat(np.array(self.plane, np.int32), counts)


def front(rng: np.random.Generator, length_m: float, floors: int) -> Collection:
    """Front of a building along x from 0, facing +y at y = 0, on z = 0."""
    made = Collection()
    storey = rng.uniform(2.6, 3.6)
    ground = storey * rng.uniform(1.0, 1.35)
    bay = rng.uniform(1.8, 4.2)
    bays = max(int(length_m / bay), 1)
    bay = length_m / bays
    wide, tall = rng.uniform(0.35, 0.75) * bay, rng.uniform(0.4, 0.65) * storey
    sill, deep = rng.uniform(0.1, 0.3) * storey, rng.uniform(0.06, 0.35)
    thick = 0.4
    x = np.linspace(0.5 * bay, length_m - 0.5 * bay, bays)
    z0 = ground + storey * np.arange(floors - 1)
    levels = np.concatenate([[0.0], z0])
    tops = np.concatenate([z0, [ground + storey * (floors - 1)]])
    door = int(rng.integers(bays))
    for floor, (low, high) in enumerate(zip(levels, tops, strict=True)):
        bottom = low + (sill if floor else rng.uniform(0.0, 0.8))
        head = min(bottom + tall * (1.2 if floor == 0 else 1.0), high - 0.25)
        strips = [(low, bottom), (head, high)]
        for a, b in strips:
            if b - a > 0.02:
                made.add(
                    box((length_m, thick, b - a), (0.5 * length_m, -0.5 * thick, 0.5 * (a + b))),
                    plane=1,
                )
        pier = bay - wide
        edges = np.concatenate([[0.5 * pier / 2], x[:-1] + 0.5 * bay, [length_m - 0.25 * pier]])
        widths = np.concatenate([[0.5 * pier], np.full(bays - 1, pier), [0.5 * pier]])
        size = np.stack([widths, np.full(bays + 1, thick), np.full(bays + 1, head - bottom)], 1)
        centre = np.stack(
            [edges, np.full(bays + 1, -0.5 * thick), np.full(bays + 1, 0.5 * (bottom + head))], 1
        )
        made.add(boxes(size, centre), plane=1)
        blind = rng.random(bays) < 0.15
        for k in range(bays):
            if floor == 0 and k == door:
                made.add(box((wide, 0.06, head), (x[k], -deep, 0.5 * head)))
                made.add(box((wide + 0.4, 0.5, 0.12), (x[k], 0.25, 0.1)))
                continue
            pane = box((wide, 0.02, head - bottom), (x[k], -deep, 0.5 * (bottom + head)))
            made.add(pane, loss=0.0 if blind[k] else GLASS)
    _ornament(rng, made, x, wide, levels, tops, length_m)
    return made


def _ornament(
    rng: np.random.Generator,
    made: Collection,
    x: F64,
    wide: float,
    levels: F64,
    tops: F64,
    length: float,
) -> None:
    """Sills, balconies, bays, awnings, pipes, cornices, boxes: what makes fronts differ."""
    n = len(x)
    for low in levels[1:]:
        if rng.random() < 0.6:
            made.add(
                boxes(
                    np.tile([wide + 0.2, 0.25, 0.07], (n, 1)),
                    np.stack([x, np.full(n, 0.08), np.full(n, low + 0.45)], 1),
                )
            )
        for k in np.nonzero(rng.random(n) < 0.3)[0] if rng.random() < 0.6 else ():
            out, w = rng.uniform(0.5, 1.5), wide + rng.uniform(0.2, 1.0)
            made.add(box((w, out, 0.15), (x[k], 0.5 * out, low)))
            rail = moved(frame(w, 1.0, 0.05, 0.05), (x[k], out, low + 0.5))
            made.add(rail)
            bars = np.tile([x[k], out, low + 0.5], (7, 1))
            bars[:, 0] += np.linspace(-0.5 * w, 0.5 * w, 7)
            made.add(boxes(np.tile([0.03, 0.03, 1.0], (7, 1)), bars))
    if rng.random() < 0.4:
        place, out = x[rng.integers(n)], rng.uniform(0.4, 1.0)
        tall = tops[-1] * rng.uniform(0.5, 0.9)
        made.add(box((wide + 0.6, out, tall), (place, 0.5 * out, 0.5 * tall)))
    if rng.random() < 0.4:
        slope, high = rng.uniform(0.8, 1.8), rng.uniform(2.3, 2.9)
        a, b = sorted(rng.uniform(0.0, length, 2))
        corners = np.array(
            [[[a, 0, high + 0.5], [a, slope, high]], [[b, 0, high + 0.5], [b, slope, high]]]
        )
        made.add(grid(corners))
    for p in rng.uniform(0.0, length, int(rng.integers(0, 4))):
        made.add(tube([[p, 0.1, 0.0], [p, 0.1, tops[-1]]], 0.06, 6))
    made.add(
        box(
            (length, rng.uniform(0.1, 0.5), rng.uniform(0.15, 0.5)), (0.5 * length, 0.15, tops[-1])
        )
    )
    for _ in range(int(rng.integers(0, 5))):
        size = rng.uniform([0.3, 0.15, 0.3], [1.6, 0.5, 1.0])
        made.add(box(size, (rng.uniform(0, length), 0.5 * size[1], rng.uniform(1.2, tops[-1]))))


def building(rng: np.random.Generator, length_m: float) -> Collection:
    """A building along x from 0 with its detailed front at y = 0, its body behind, a roof."""
    floors = int(rng.choice([1, 2, 3, 4, 6], p=[0.15, 0.35, 0.25, 0.15, 0.1]))
    made = front(rng, length_m, floors)
    top = max(float(m.vertices[:, 2].max()) for m in made.meshes[:3])
    deep = rng.uniform(6.0, 14.0)
    body = box((length_m, deep, top), (0.5 * length_m, -0.4 - 0.5 * deep, 0.5 * top))
    made.add(body, plane=1)
    for side in (0.0, length_m):
        count = int(rng.integers(0, 6))
        for y, z in zip(
            rng.uniform(-deep, -1.0, count), rng.uniform(0.8, top - 0.8, count), strict=True
        ):
            made.add(box((0.2, rng.uniform(0.5, 1.5), rng.uniform(0.5, 1.6)), (side, y, z)))
    if rng.random() < 0.7:
        ridge, eave = top + rng.uniform(1.5, 4.5), rng.uniform(0.1, 0.7)
        mid = -0.4 - 0.5 * deep
        rows = [[-0.2, eave, top - 0.1], [-0.2, mid, ridge], [-0.2, -deep - eave, top - 0.1]]
        left = np.array(rows)
        right = left * [0.0, 1.0, 1.0] + [length_m + 0.2, 0.0, 0.0]
        made.add(grid(np.stack([left, right])), plane=1)
        for x in (0.0, length_m):
            gable = np.array([[[x, 0.0, top], [x, mid, ridge]], [[x, mid, top], [x, -deep, top]]])
            made.add(grid(gable))
        for _ in range(int(rng.integers(0, 3))):
            made.add(box((0.6, 0.8, 1.6), (rng.uniform(0.5, length_m), mid + 1.0, ridge)))
    return made


def wall(rng: np.random.Generator, length_m: float) -> Mesh:
    """A garden wall, a fence of slats, rails or bars along x from 0, on z = 0."""
    tall = rng.uniform(0.5, 2.1)
    style = rng.choice(['solid', 'slats', 'rails', 'bars'])
    posts = np.arange(0.0, length_m + 0.01, rng.uniform(1.5, 3.2))
    one = np.ones(len(posts))
    post = boxes(
        np.stack([0.1 * one, 0.1 * one, (tall + 0.1) * one], 1),
        np.stack([posts, 0.0 * one, 0.5 * tall * one], 1),
    )
    if style == 'solid':
        thick = rng.uniform(0.12, 0.4)
        cap = box((length_m, thick + 0.1, 0.08), (0.5 * length_m, 0.0, tall))
        return merge([box((length_m, thick, tall), (0.5 * length_m, 0.0, 0.5 * tall)), cap, post])
    if style == 'rails':
        z = np.linspace(0.3, 1.0, int(rng.integers(2, 5))) * tall
        size = np.tile([length_m, 0.04, rng.uniform(0.05, 0.16)], (len(z), 1))
        at = np.stack([np.full(len(z), 0.5 * length_m), 0.0 * z, z], 1)
        return merge([boxes(size, at), post])
    gap = rng.uniform(0.12, 0.3) if style == 'slats' else rng.uniform(0.1, 0.2)
    x = np.arange(0.0, length_m, gap)
    wide = 0.75 * gap if style == 'slats' else 0.025
    tip = tall + rng.normal(0.0, 0.02, len(x))
    size = np.stack([np.full(len(x), wide), np.full(len(x), 0.025), tip], 1)
    return merge([boxes(size, np.stack([x, 0.0 * x, 0.5 * tip], 1)), post])


def rack(rng: np.random.Generator, length_m: float) -> Mesh:
    """A pallet rack along x from 0, filled at random, centred on y = 0, on z = 0."""
    deep, bay = rng.uniform(0.8, 1.3), rng.uniform(1.8, 3.0)
    levels = np.cumsum(rng.uniform(1.1, 2.0, int(rng.integers(2, 5))))
    bays = max(int(length_m / bay), 1)
    top = levels[-1] + rng.uniform(0.2, 1.2)
    parts = []
    for x in bay * np.arange(bays + 1):
        parts += [box((0.1, 0.08, top), (x, y, 0.5 * top)) for y in (-0.5 * deep, 0.5 * deep)]
        z = np.linspace(0.2, top, 6)
        zig = np.stack([np.full(6, x), np.where(np.arange(6) % 2, 0.5, -0.5) * deep, z], 1)
        parts.append(tube(zig, 0.025, 4))
    for z in levels:
        parts += [
            box((bay * bays, 0.05, 0.13), (0.5 * bay * bays, y, z))
            for y in (-0.5 * deep, 0.5 * deep)
        ]
    sizes, centres = [], []
    for z in np.concatenate([[0.0], levels]):
        x = 0.15
        while x < bay * bays - 0.6:
            w, d, h = rng.uniform([0.4, 0.5, 0.3], [1.3, deep, 1.0])
            if rng.random() < 0.78:
                y = rng.normal(0.0, 0.06)
                sizes += [[w, d, h], [w, deep, 0.12]]
                centres += [[x + 0.5 * w, y, z + 0.2 + 0.5 * h], [x + 0.5 * w, 0.0, z + 0.14]]
                if rng.random() < 0.4:
                    sizes.append([0.6 * w, 0.6 * d, 0.4 * h])
                    centres.append([x + 0.4 * w, y, z + 0.2 + 1.2 * h])
            x += w + rng.uniform(0.04, 0.5)
    if sizes:
        parts.append(boxes(sizes, centres))
    return merge(parts)


def pole(rng: np.random.Generator) -> Mesh:
    """Lamp post, sign, traffic light, bollard, or a wooden pole with arms; on z = 0."""
    style = rng.choice(['lamp', 'sign', 'light', 'bollard', 'wood'], p=[0.3, 0.3, 0.1, 0.2, 0.1])
    r = rng.uniform(0.03, 0.1)
    if style == 'bollard':
        tall = rng.uniform(0.5, 1.1)
        return merge([cylinder(1.3 * r, tall, 9), moved(cylinder(1.7 * r, 0.1, 9), (0, 0, tall))])
    if style == 'lamp':
        tall, arm = rng.uniform(3.5, 9.0), rng.uniform(0.0, 2.0)
        path = np.array([[0, 0, 0], [0, 0, 0.8], [0.2, 0, 0.95], [1.0, 0, 1.0]])
        path = path * [arm, 0.0, tall]
        return merge(
            [
                tube(path, [1.4 * r, r, 0.7 * r, 0.6 * r], 8),
                box((0.5, 0.25, 0.15), (arm, 0, tall)),
                box((0.3, 0.3, 0.6), (0, 0, 0.3)),
            ]
        )
    if style == 'sign':
        tall = rng.uniform(1.9, 3.0)
        plate = box(rng.uniform([0.02, 0.4, 0.3], [0.05, 1.0, 0.9]), (r, 0, tall - 0.3))
        turn = rot_z(rng.uniform(0.0, 2.0 * np.pi))
        return moved(merge([cylinder(0.04, tall, 8), plate]), R=turn)
    if style == 'light':
        return merge(
            [
                cylinder(0.07, 3.2, 8),
                box((0.3, 0.3, 0.9), (0.25, 0, 2.6)),
                box((0.25, 0.3, 0.5), (-0.2, 0, 1.4)),
            ]
        )
    tall = rng.uniform(6.0, 9.0)
    arms = [box((0.1, 1.8, 0.1), (0, 0, tall - k)) for k in (0.4, 1.0)]
    stem = np.array([[0.0, 0.0, 0.0], [*rng.normal(0.0, 0.15, 2), tall]])
    return merge([tube(stem, [0.15, 0.1], 9), *arms])


def street_thing(rng: np.random.Generator) -> Mesh:
    """Bench, bin, cabinet, planter, shelter, cones, crates: x along the street, on z = 0."""
    style = rng.choice(['bench', 'bin', 'cabinet', 'planter', 'shelter', 'crates', 'board'])
    if style == 'bench':
        w = rng.uniform(1.2, 2.2)
        seat = [[w, 0.12, 0.04]] * 3 + [[w, 0.04, 0.12]] * 2
        at = [[0, y, 0.45] for y in (-0.2, 0.0, 0.2)] + [[0, -0.28, z] for z in (0.62, 0.82)]
        legs = [[0.06, 0.5, 0.45]] * 2
        return boxes(seat + legs, [*at, [-0.4 * w, 0, 0.22], [0.4 * w, 0, 0.22]])
    if style == 'bin':
        r, h = rng.uniform(0.18, 0.4), rng.uniform(0.7, 1.3)
        return merge([cylinder(r, h, 12), moved(cylinder(1.1 * r, 0.08, 12), (0, 0, h))])
    if style == 'cabinet':
        size = rng.uniform([0.4, 0.25, 0.8], [1.8, 0.6, 1.6])
        return box(size, (0, 0, 0.5 * size[2]))
    if style == 'planter':
        size = rng.uniform([0.5, 0.5, 0.3], [2.0, 1.0, 0.8])
        return box(size, (0, 0, 0.5 * size[2]))
    if style == 'shelter':
        w, d = rng.uniform(2.2, 4.5), rng.uniform(1.1, 1.6)
        return boxes([[w, 0.03, 2.0], [w, d, 0.08], [0.03, d, 2.0], [0.08, 0.08, 2.3],
                      [0.7 * w, 0.35, 0.05]],
                     [[0, -0.5 * d, 1.2], [0, 0, 2.35], [-0.5 * w, 0, 1.2],
                      [0.5 * w, 0.5 * d, 1.15], [0, -0.3 * d, 0.48]])  # fmt: skip
    if style == 'board':
        return boxes([[0.9, 0.04, 1.1], [0.06, 0.3, 1.3]], [[0, 0, 0.75], [0.45, 0, 0.65]])
    count = int(rng.integers(2, 7))
    crates = rng.uniform(0.25, 0.9, (count, 3))
    spots = rng.normal(0.0, 0.5, (count, 3))
    spots[:, 2] = 0.5 * crates[:, 2]
    return boxes(crates, spots)
