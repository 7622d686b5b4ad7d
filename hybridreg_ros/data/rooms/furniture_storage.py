# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Furniture that holds things: shelves, cabinets, wardrobes, kitchens, crates."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from hybridreg_ros.data.meshes import shapes
from hybridreg_ros.data.meshes.csg import free_form
from hybridreg_ros.data.meshes.geometry import moved, rot_x, turned
from hybridreg_ros.data.meshes.scene import Mesh, merge
from hybridreg_ros.data.rooms.furniture import Piece, Surface


def _books(rng: np.random.Generator, x: float, w: float, d: float, z: float) -> list[Mesh]:
    """A row of books of random size, some leaning, from x over a width w on height z."""
    row = []
    end = x + w
    while x < end:
        thick = rng.uniform(0.02, 0.09)
        tall, deep = rng.uniform(0.14, 0.33), min(d, rng.uniform(0.1, 0.26))
        lean = rng.uniform(0.1, 0.3) if rng.random() < 0.12 else 0.0
        y = 0.5 * (d - deep) - rng.uniform(0.0, 0.05)
        book = shapes.box([thick, deep, tall], [0.5 * thick, y, 0.5 * tall])
        shear = book.vertices.copy()
        shear[:, 0] += lean * shear[:, 2]
        row.append(moved(Mesh(shear, book.faces), [x, 0, z]))
        x += thick + (0.0 if rng.random() < 0.8 else rng.uniform(0.0, 0.12))
    return row


def shelf(rng: np.random.Generator) -> Piece:
    """Shelf with boards, uprights and varied content: books, boxes, vases, gaps."""
    w, d, h = rng.uniform(0.5, 2.0), rng.uniform(0.22, 0.45), rng.uniform(0.6, 2.3)
    levels = max(2, int(h / rng.uniform(0.28, 0.5)))
    heights = np.linspace(0.04, h, levels + 1)
    heights[1:-1] += rng.uniform(-0.05, 0.05, levels - 1)
    parts = [shapes.box([w, d, 0.025], [0, 0, z]) for z in heights]
    columns = np.linspace(-0.5, 0.5, int(rng.integers(2, 5))) * w
    parts += [shapes.box([0.025, d, h], [x, 0, 0.5 * h]) for x in columns]
    if rng.random() < 0.6:
        parts.append(shapes.box([w, 0.01, h], [0, -0.5 * d, 0.5 * h]))
    for low, high in pairwise(heights):
        for left, right in pairwise(columns):
            parts += _bay(rng, left, right - left, d, low + 0.0125, high - low - 0.03)
    return Piece(merge(parts), (Surface(0, 0, h + 0.0125, 0.85 * w, 0.7 * d, 0.4),), wall=True)


def _bay(
    rng: np.random.Generator, x: float, w: float, d: float, z: float, room: float
) -> list[Mesh]:
    """Content of one compartment."""
    kind = rng.choice(4, p=[0.4, 0.2, 0.25, 0.15])
    if kind == 0:
        return _books(rng, x + 0.02, rng.uniform(0.3, 0.9) * w, d, z)
    if kind == 1:
        size = rng.uniform([0.4 * w, 0.6 * d, 0.3 * room], [0.95 * w, 0.98 * d, 0.9 * room])
        return [shapes.box(size, [x + 0.5 * w, 0.0, z + 0.5 * size[2]])]
    if kind == 2:
        things = []
        for k in range(rng.integers(1, 4)):
            thing = free_form(rng, rng.uniform(0.08, 0.9 * min(room, d)))
            place = [x + w * (k + 0.7) / 4.0, rng.uniform(-0.2, 0.3) * d, z]
            things.append(turned(thing, rng.uniform(0, 6.3), place))
        return things
    return []


def cabinet(rng: np.random.Generator) -> Piece:
    """Sideboard, chest of drawers or wardrobe: plinth, fronts with gaps, handles, open door."""
    w, d = rng.uniform(0.5, 2.0), rng.uniform(0.35, 0.65)
    h = rng.choice([rng.uniform(0.45, 0.95), rng.uniform(1.7, 2.25)], p=[0.6, 0.4])
    parts = [shapes.box([w, d, h - 0.06], [0, 0, 0.5 * h + 0.03])]
    if rng.random() < 0.5:
        parts.append(shapes.box([w + 0.04, d + 0.04, 0.03], [0, 0.01, h]))
    nx = max(1, round(w / rng.uniform(0.4, 0.7)))
    nz = 1 if h > 1.4 and rng.random() < 0.6 else int(rng.integers(1, 5))
    cw, ch = w / nx, (h - 0.08) / nz
    proud = rng.uniform(0.008, 0.03)
    for i in range(nx):
        for j in range(nz):
            x, z = (i + 0.5) * cw - 0.5 * w, 0.08 + (j + 0.5) * ch
            y = 0.5 * d + 0.5 * proud + (rng.uniform(0.05, 0.25) if rng.random() < 0.06 else 0.0)
            parts.append(shapes.box([cw - 0.02, proud, ch - 0.02], [x, y, z]))
            wide = rng.random() < 0.5
            grip = [0.14, 0.03, 0.02] if wide else [0.02, 0.03, min(0.2, 0.5 * ch)]
            parts.append(shapes.box(grip, [x + (0 if wide else 0.35 * cw), y + 0.03, z]))
    if rng.random() < 0.2:
        door = shapes.box([cw, 0.02, h - 0.1], [0.5 * cw, 0, 0.5 * h + 0.04])
        parts.append(turned(door, rng.uniform(0.6, 2.0), [-0.5 * w, 0.5 * d + 0.03, 0]))
    return Piece(merge(parts), (Surface(0, 0, h + 0.015, 0.9 * w, 0.8 * d),), wall=True)


def kitchen(rng: np.random.Generator) -> Piece:
    """Kitchen counter: base units, worktop, sink, tap, hob, wall units, hood."""
    w, d, h = rng.uniform(1.5, 3.2), rng.uniform(0.55, 0.68), rng.uniform(0.84, 0.95)
    parts = [
        shapes.box([w, d - 0.06, h - 0.14], [0, -0.03, 0.1 + 0.5 * (h - 0.14)]),
        shapes.box([w + 0.02, d, 0.04], [0, 0, h - 0.02]),
    ]
    n = round(w / 0.6)
    for k in range(n):
        x = (k + 0.5) * w / n - 0.5 * w
        parts.append(shapes.box([w / n - 0.015, 0.02, h - 0.2], [x, 0.5 * d - 0.05, 0.5 * h]))
        parts.append(shapes.box([0.2, 0.04, 0.02], [x, 0.5 * d - 0.03, h - 0.16]))
    x = rng.uniform(-0.4, 0.4) * w
    bend = [[x, -0.2, h], [x, -0.2, h + 0.25], [x, -0.12, h + 0.32], [x, 0, h + 0.26]]
    parts.append(shapes.tube(bend, 0.018, 6))
    parts.append(moved(shapes.frame(0.5, 0.4, 0.03, 0.03), [x, 0, h], rot_x(0.5 * np.pi)))
    if rng.random() < 0.7:
        top = rng.uniform(1.4, 1.55)
        for k in range(n):
            if rng.random() < 0.75:
                tall = rng.uniform(0.5, 0.75)
                place = [(k + 0.5) * w / n - 0.5 * w, -0.14, top + 0.5 * tall]
                parts.append(shapes.box([w / n - 0.01, 0.34, tall], place))
    if rng.random() < 0.5:
        place = [rng.uniform(-0.3, 0.3) * w, -0.1, 1.35]
        parts.append(
            moved(
                shapes.extrusion(
                    [[-0.3, -0.2], [0.3, -0.2], [0.3, 0.25], [-0.3, 0.25]], 0.35, top_scale=0.35
                ),
                place,
            )
        )
    return Piece(merge(parts), (Surface(0, 0.02, h, 0.92 * w, 0.7 * d, 0.4),), wall=True)


def crates(rng: np.random.Generator) -> Piece:
    """A pile of cartons and crates of random size, each turned a little."""
    parts = []
    x = 0.0
    for _ in range(rng.integers(1, 4)):
        z, base = 0.0, rng.uniform(0.25, 0.6)
        for _ in range(rng.integers(1, 4)):
            size = base * rng.uniform([0.7, 0.6, 0.4], [1.0, 1.0, 0.9])
            thing = shapes.box(size, [0, 0, 0.5 * size[2]])
            parts.append(turned(thing, rng.uniform(-0.5, 0.5), [x, rng.uniform(-0.05, 0.05), z]))
            z += size[2]
        x += base + rng.uniform(0.0, 0.15)
    mesh = merge(parts)
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    return Piece(moved(mesh, [*(-0.5 * (low + high))[:2], 0.0]), movable=True)


def stairs(rng: np.random.Generator) -> Piece:
    """A flight of stairs, with or without risers and hand rail."""
    n, rise, tread = int(rng.integers(3, 11)), rng.uniform(0.15, 0.2), rng.uniform(0.24, 0.32)
    w, closed = rng.uniform(0.7, 1.2), rng.random() < 0.6
    parts = []
    for k in range(n):
        tall = (k + 1) * rise if closed else 0.05
        parts.append(
            shapes.box([tread, w, tall], [(k + 0.5) * tread, 0, (k + 1) * rise - 0.5 * tall])
        )
    if rng.random() < 0.7:
        rail = rng.uniform(0.8, 1.0)
        for k in range(0, n, 2):
            foot = [(k + 0.5) * tread, 0.47 * w, (k + 1) * rise]
            parts.append(shapes.tube([foot, [foot[0], foot[1], foot[2] + rail]], 0.015, 6))
        ends = [
            [0.5 * tread, 0.47 * w, rise + rail],
            [(n - 0.5) * tread, 0.47 * w, n * rise + rail],
        ]
        parts.append(shapes.tube(ends, 0.03, 8))
    mesh = moved(merge(parts), [-0.5 * n * tread, 0, 0])
    return Piece(mesh, wall=True)
