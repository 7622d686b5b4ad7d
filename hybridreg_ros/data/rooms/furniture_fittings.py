# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fittings and odd pieces: lamps, plants, radiators, curtains, pictures, pianos, sculptures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.meshes import shapes
from hybridreg_ros.data.meshes.csg import free_form
from hybridreg_ros.data.meshes.geometry import SmoothNoise, moved, random_rotation, turned
from hybridreg_ros.data.meshes.scene import Mesh, merge
from hybridreg_ros.data.rooms import furniture as seats
from hybridreg_ros.data.rooms import furniture_storage as storage
from hybridreg_ros.data.rooms.furniture import Piece, Surface

if TYPE_CHECKING:
    from collections.abc import Callable


def lamp(rng: np.random.Generator) -> Piece:
    """Floor lamp: foot, straight or bent pole, shade."""
    h, bend = rng.uniform(1.2, 1.9), rng.uniform(-0.35, 0.35)
    s = np.linspace(0, 1, 6)
    pole = np.column_stack([bend * s**3, 0 * s, h * s])
    r = rng.uniform(0.12, 0.28)
    shade = shapes.lathe([[r * rng.uniform(0.4, 1.0), 0.0], [r, -rng.uniform(0.15, 0.35)]], 14)
    parts = [
        shapes.lathe(shapes.random_profile(rng, rng.uniform(0.12, 0.2), 0.08, 5)),
        shapes.tube(pole, rng.uniform(0.012, 0.025), 6),
        moved(shade, pole[-1] + [0, 0, 0.08]),
    ]
    return Piece(merge(parts), movable=True)


def plant(rng: np.random.Generator) -> Piece:
    """Potted plant: pot, stems, leaves as bent ellipses."""
    pot_r, pot_h = rng.uniform(0.1, 0.25), rng.uniform(0.15, 0.45)
    parts = [shapes.lathe(shapes.random_profile(rng, pot_r, pot_h, 6))]
    top, leaf = rng.uniform(0.3, 1.5), rng.uniform(0.06, 0.3)
    for _ in range(rng.integers(3, 8)):
        tip = rng.normal(0.0, 0.25, 3) * [top, top, 0.0] + [
            0,
            0,
            pot_h + top * rng.uniform(0.5, 1),
        ]
        s = np.linspace(0, 1, 5)[:, None]
        sag = [0, 0, 0.25 * top]
        stem = (1 - s) * [0, 0, pot_h] + s * tip + s * (1 - s) * sag
        parts.append(shapes.tube(stem, 0.01, 5))
        count = rng.integers(3, 8)
        parts += [_leaf(rng, stem[rng.integers(2, 5)], leaf) for _ in range(count)]
    return Piece(merge(parts), movable=True)


def _leaf(rng: np.random.Generator, base: np.ndarray, size: float) -> Mesh:
    """One bent leaf growing from a point."""
    u = np.linspace(0, 1, 4)
    half = 0.25 * np.sin(np.pi * np.clip(u, 0.05, 1)) + 0.01
    bow = -rng.uniform(0.1, 0.8) * u**2
    left = np.column_stack([u, half, bow])
    mesh = shapes.grid(np.stack([left, left * [1, -1, 1]]) * size * rng.uniform(0.6, 1.3))
    return moved(mesh, base, random_rotation(rng))


def radiator(rng: np.random.Generator) -> Piece:
    """Radiator of ribs or of a panel, with pipes."""
    w, h, d = rng.uniform(0.5, 1.6), rng.uniform(0.4, 0.9), rng.uniform(0.06, 0.16)
    low = rng.uniform(0.08, 0.16)
    if rng.random() < 0.7:
        x = np.arange(-0.5 * w, 0.5 * w, rng.uniform(0.045, 0.08))
        parts = [shapes.cushion([0.035, d, h], [q, 0, low + 0.5 * h], 0.4) for q in x]
    else:
        parts = [shapes.box([w, 0.3 * d, h], [0, s * 0.3 * d, low + 0.5 * h]) for s in (-1, 1)]
    parts.append(shapes.tube([[-0.55 * w, 0, 0], [-0.55 * w, 0, low], [0, 0, low]], 0.014, 6))
    return Piece(merge(parts), wall=True)


def curtain(rng: np.random.Generator) -> Piece:
    """Curtain or hanging cloth in folds, on a rod."""
    w, h, low = rng.uniform(0.5, 2.2), rng.uniform(1.4, 2.3), rng.uniform(0.0, 0.2)
    n = max(12, int(w / 0.05))
    x = np.linspace(-0.5, 0.5, n) * w
    depth, fold = rng.uniform(0.02, 0.07), rng.uniform(0.1, 0.22)
    phase = SmoothNoise(rng, (0.3, 1.5), 1.5, dim=1)(x[:, None])
    rows = []
    for s in np.linspace(0, 1, 5):
        y = (0.6 + 0.5 * s) * depth * np.sin(2 * np.pi * x / fold + phase * (1 + 0.3 * s))
        rows.append(np.column_stack([x * (1 - 0.1 * s), y, np.full(n, low + h * (1 - s))]))
    rod = shapes.tube([[-0.6 * w, 0, low + h], [0.6 * w, 0, low + h]], 0.015, 6)
    return Piece(merge([shapes.grid(np.stack(rows)), rod]), wall=True)


def picture(rng: np.random.Generator) -> Piece:
    """Things that hang on a wall: picture frames, boards, clocks, wall shelves, coats."""
    parts = []
    x = -rng.uniform(0.0, 0.8)
    for _ in range(rng.integers(1, 4)):
        w, h, z = rng.uniform(0.2, 1.2), rng.uniform(0.2, 0.9), rng.uniform(1.2, 1.8)
        kind = rng.integers(4)
        if kind == 0:
            deep = rng.uniform(0.02, 0.06)
            parts.append(moved(shapes.frame(w, h, deep, rng.uniform(0.02, 0.08)), [x, 0, z]))
            parts.append(shapes.box([w, 0.01, h], [x, -0.01, z]))
        elif kind == 1:
            parts.append(shapes.box([w, rng.uniform(0.02, 0.12), h], [x, 0, z]))
        elif kind == 2:
            parts.append(shapes.box([w, 0.22, 0.03], [x, 0.1, z]))
            for _ in range(rng.integers(1, 6)):
                thing = free_form(rng, rng.uniform(0.08, 0.35))
                parts.append(moved(thing, [x + rng.uniform(-0.4, 0.4) * w, 0.1, z + 0.015]))
        else:
            parts.append(moved(_coat(rng), [x, 0.12, z - 0.4]))
        x += w + rng.uniform(0.0, 0.4)
    mesh = merge(parts)
    return Piece(moved(mesh, [-float(mesh.vertices[:, 0].mean()), 0, 0]), wall=True)


def _coat(rng: np.random.Generator) -> Mesh:
    """Hanging coat or bag: a folded extrusion, wide below."""
    outline = shapes.star_outline(rng, 0.16, 24) * [1.5, 0.7]
    return shapes.extrusion(outline, rng.uniform(0.4, 0.9), top_scale=rng.uniform(0.3, 0.8))


def piano(rng: np.random.Generator) -> Piece:
    """Upright piano or similar stepped body with a stool."""
    w, d, h = rng.uniform(1.2, 1.5), rng.uniform(0.5, 0.65), rng.uniform(1.0, 1.3)
    parts = [
        shapes.box([w, 0.5 * d, h], [0, -0.25 * d, 0.5 * h]),
        shapes.box([w, 0.55 * d, 0.12], [0, 0.2 * d, 0.68]),
        shapes.box([0.06, 0.1, 0.65], [-0.46 * w, 0.4 * d, 0.32]),
        shapes.box([0.06, 0.1, 0.65], [0.46 * w, 0.4 * d, 0.32]),
        shapes.box([0.45, 0.02, 0.3], [0, 0.02, h - 0.2]),
    ]
    return Piece(merge(parts), (Surface(0, -0.25 * d, h, 0.8 * w, 0.3 * d),), wall=True)


def bathroom(rng: np.random.Generator) -> Piece:
    """Tub, basin or bowl: shells of revolution stretched to an oval."""
    w, d, h = rng.uniform([0.4, 0.4, 0.35], [1.7, 0.75, 0.85])
    rim = rng.uniform(0.8, 0.93)
    profile = [[0.5, 0], [1.0, 1.0], [rim, 1.0], [0.4, 0.35], [0.0, 0.3]]
    shell = moved(shapes.lathe(profile, 20), scale=[0.5 * w, 0.5 * d, h])
    tank = shapes.box([0.4, 0.15, 0.35], [0, -0.5 * d, h + 0.1])
    return Piece(merge([shell, tank] if rng.random() < 0.5 else [shell]), wall=True)


def sculpture(rng: np.random.Generator) -> Piece:
    """Large free-form thing: machine, sculpture, luggage, toy, pouf."""
    size = rng.uniform(0.4, 1.5)
    parts = [free_form(rng, size)]
    for _ in range(rng.integers(0, 3)):
        more = free_form(rng, rng.uniform(0.3, 0.8) * size)
        place = [*rng.uniform(-0.25, 0.25, 2) * size, rng.uniform(0.0, 0.6) * size]
        parts.append(turned(more, rng.uniform(0, 6.3), place))
    return Piece(merge(parts), movable=size < 0.8)


def rack(rng: np.random.Generator) -> Piece:
    """Thin structure: clothes rack, ladder, tripod, bicycle-like tubes and wheels."""
    if rng.random() < 0.4:
        return Piece(_bicycle(rng), movable=True)
    w, h, d = rng.uniform(0.4, 1.4), rng.uniform(0.8, 1.9), rng.uniform(0.3, 0.6)
    parts = [
        shapes.tube([[sx * 0.5 * w, sy * 0.5 * d, 0], [sx * 0.5 * w, 0, h]], 0.018, 6)
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    rungs = np.linspace(0.25, 1.0, rng.integers(1, 7)) * h
    parts += [shapes.tube([[-0.5 * w, 0, z], [0.5 * w, 0, z]], 0.015, 6) for z in rungs]
    if rng.random() < 0.6:
        hooks = rng.uniform(-0.4, 0.4, rng.integers(1, 6)) * w
        parts += [turned(_coat(rng), 1.57, [x, 0, h - 0.85]) for x in hooks]
    return Piece(merge(parts), movable=True)


def _bicycle(rng: np.random.Generator) -> Mesh:
    """Two wheels, a frame, a fork, handlebars and a saddle; every measure varies."""
    r, reach = rng.uniform(0.2, 0.37), rng.uniform(0.38, 0.58)
    tyre, bar = rng.uniform(0.012, 0.04), rng.uniform(0.012, 0.025)
    seat, head = rng.uniform(0.6, 1.0), rng.uniform(0.7, 1.15)
    spine = np.array(
        [[-reach, 0, r], [0.0, 0, 0.85 * r], [0.28, 0, 0.8 * head], [-0.22, 0, seat], [0, 0, r]]
    )
    spine[1:, [0, 2]] += rng.normal(0.0, 0.04, (4, 2))
    fork = [[reach, 0, r], [0.7 * reach, 0, head], [0.6 * reach, 0.0, head + 0.05]]
    grip, turn = rng.uniform(0.18, 0.33), rng.normal(0.0, 0.1)
    bars = [[0.6 * reach + side * turn, side * grip, head + 0.07] for side in (-1, 0, 1)]
    saddle = shapes.cushion([0.26, rng.uniform(0.1, 0.2), 0.07], [-0.24, 0.0, seat + 0.04])
    wheels = [
        moved(shapes.torus(r - tyre, tyre, 20, 6), [x, 0, r], _upright()) for x in (-reach, reach)
    ]
    tubes = [shapes.tube(path, bar, 6) for path in (spine, fork, bars)]
    return merge([*wheels, *tubes, saddle])


def _upright() -> np.ndarray:
    return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


FAMILIES: dict[str, tuple[Callable[[np.random.Generator], Piece], float]] = {
    'table': (seats.table, 1.4),
    'chair': (seats.chair, 2.6),
    'sofa': (seats.sofa, 1.0),
    'bed': (seats.bed, 0.5),
    'desk': (seats.desk, 1.2),
    'shelf': (storage.shelf, 1.3),
    'cabinet': (storage.cabinet, 1.2),
    'kitchen': (storage.kitchen, 0.4),
    'crates': (storage.crates, 0.8),
    'stairs': (storage.stairs, 0.25),
    'lamp': (lamp, 0.7),
    'plant': (plant, 0.8),
    'radiator': (radiator, 0.5),
    'curtain': (curtain, 0.5),
    'picture': (picture, 0.9),
    'piano': (piano, 0.2),
    'bathroom': (bathroom, 0.3),
    'sculpture': (sculpture, 1.0),
    'rack': (rack, 0.5),
}
