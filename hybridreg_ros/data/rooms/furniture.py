# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Furniture that people sit at, on and in: tables, chairs, sofas, beds, desks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hybridreg_ros.data.meshes import shapes
from hybridreg_ros.data.meshes.geometry import moved, rot_x, rot_z, turned
from hybridreg_ros.data.meshes.scene import Mesh, merge

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Surface(NamedTuple):
    """A horizontal rectangle that carries clutter, in the frame of its piece, metres."""

    x: float
    y: float
    z: float
    width: float
    depth: float
    headroom: float = 0.6


@dataclass(frozen=True, eq=False)
class Piece:
    """One piece of furniture: stands on z = 0 about the origin, its back towards -y.

    Attributes:
        mesh: triangles, piece frame, metres.
        surfaces: where clutter may stand.
        wall: its back belongs to a wall.
        movable: people shift it.
    """

    mesh: Mesh
    surfaces: tuple[Surface, ...] = ()
    wall: bool = False
    movable: bool = False


def _legs(rng: np.random.Generator, w: float, d: float, h: float) -> list[Mesh]:
    """Four legs, panels, a trestle or a pedestal below a top of w x d at height h."""
    kind = rng.choice(4, p=[0.55, 0.15, 0.12, 0.18])
    x, y = 0.46 * w, 0.44 * d
    if kind == 0:
        r, splay = rng.uniform(0.015, 0.045), rng.uniform(0.0, 0.06)
        square = rng.random() < 0.5
        return [
            shapes.box([2 * r, 2 * r, h], [sx * x, sy * y, 0.5 * h])
            if square
            else shapes.tube([[sx * (x + splay), sy * (y + splay), 0], [sx * x, sy * y, h]], r)
            for sx in (-1, 1)
            for sy in (-1, 1)
        ]
    if kind == 1:
        return [shapes.box([0.04, 2 * y, h], [sx * x, 0, 0.5 * h]) for sx in (-1, 1)]
    if kind == 2:
        bars = [
            shapes.tube([[sx * x, sy * y, 0], [sx * x, 0, h]], 0.025)
            for sx in (-1, 1)
            for sy in (-1, 1)
        ]
        return [*bars, shapes.box([2 * x, 0.03, 0.06], [0, 0, 0.5 * h])]
    profile = shapes.random_profile(rng, rng.uniform(0.06, 0.2), h)
    foot = shapes.cylinder(rng.uniform(0.2, 0.35), rng.uniform(0.02, 0.06))
    return [shapes.lathe(profile, 12), foot]


def table(rng: np.random.Generator) -> Piece:
    """Dining, coffee or side table: rectangular, rounded, oval or free-form top."""
    w, d = rng.uniform(0.5, 2.2), rng.uniform(0.45, 1.1)
    h = rng.choice([rng.uniform(0.3, 0.55), rng.uniform(0.68, 0.78), rng.uniform(0.9, 1.1)])
    thick = rng.uniform(0.015, 0.06)
    kind = rng.integers(4)
    if kind == 0:
        top = shapes.box([w, d, thick], [0, 0, h - 0.5 * thick])
    elif kind == 1:
        top = shapes.cushion([w, d, thick], [0, 0, h - 0.5 * thick], 0.2)
    elif kind == 2:
        top = moved(shapes.cylinder(0.5, thick, 22), [0, 0, h - thick], scale=[w, d, 1.0])
    else:
        top = shapes.extrusion(shapes.star_outline(rng, 0.42), thick)
        top = moved(top, [0, 0, h - thick], scale=[w, d, 1.0])
    parts = [top, *_legs(rng, w * 0.85, d * 0.85, h - thick)]
    if rng.random() < 0.25:
        parts.append(shapes.box([0.8 * w, 0.8 * d, 0.02], [0, 0, rng.uniform(0.25, 0.6) * h]))
    shrink = 0.9 if kind < 2 else 0.6
    surface = Surface(0, 0, h, shrink * w, shrink * d)
    return Piece(merge(parts), (surface,), movable=w < 1.3)


def chair(rng: np.random.Generator) -> Piece:
    """Chair, armchair-like chair, bar stool or office chair."""
    w, d = rng.uniform(0.36, 0.55), rng.uniform(0.36, 0.52)
    h = rng.choice([rng.uniform(0.4, 0.5), rng.uniform(0.6, 0.75)], p=[0.85, 0.15])
    seat_h = rng.uniform(0.02, 0.1)
    seat = shapes.cushion([w, d, seat_h], [0, 0, h], rng.uniform(0.1, 0.6))
    parts = [seat]
    if rng.random() < 0.35:
        parts += _star_base(rng, h)
    else:
        parts += _legs(rng, w, d, h)
    if rng.random() < 0.88:
        parts.append(_chair_back(rng, w, d, h))
    if rng.random() < 0.35:
        for side in (-1, 1):
            x, top = side * 0.5 * w, h + rng.uniform(0.16, 0.26)
            path = [[x, -0.4 * d, top], [x, 0.3 * d, top], [x, 0.35 * d, h]]
            parts.append(shapes.tube(path, rng.uniform(0.015, 0.035), 6))
    surface = Surface(0, 0, h + 0.5 * seat_h, 0.6 * w, 0.6 * d)
    return Piece(merge(parts), (surface,) if rng.random() < 0.3 else (), movable=True)


def _chair_back(rng: np.random.Generator, w: float, d: float, h: float) -> Mesh:
    """Padded, slatted, barred or curved back, leaning backwards."""
    tall, lean = rng.uniform(0.28, 0.75), rng.uniform(0.0, 0.3)
    kind = rng.integers(4)
    if kind == 0:
        back = shapes.cushion([w, rng.uniform(0.03, 0.1), tall], [0, 0, 0.5 * tall], 0.35)
    elif kind == 1:
        z = np.linspace(0.1, 1.0, rng.integers(2, 5)) * tall
        slats = [shapes.box([w, 0.02, rng.uniform(0.03, 0.08)], [0, 0, q]) for q in z]
        posts = [shapes.box([0.03, 0.03, tall], [s * 0.47 * w, 0, 0.5 * tall]) for s in (-1, 1)]
        back = merge([*slats, *posts])
    elif kind == 2:
        x = np.linspace(-0.45, 0.45, rng.integers(4, 9)) * w
        bars = [shapes.tube([[q, 0, 0], [q, 0, tall]], 0.01, 5) for q in x]
        back = merge([*bars, shapes.box([w, 0.03, 0.06], [0, 0, tall])])
    else:
        a = np.linspace(-1.1, 1.1, 9)
        low = np.column_stack([0.5 * w * np.sin(a), 0.5 * w * (1 - np.cos(a)), 0 * a])
        back = shapes.grid(np.stack([low, low + np.array([0, -0.05, tall])]))
    return moved(back, [0, -0.5 * d, h], rot_x(lean))


def _star_base(rng: np.random.Generator, h: float) -> list[Mesh]:
    """Office chair base: column, star of feet, castors."""
    n = int(rng.integers(4, 7))
    r = rng.uniform(0.25, 0.34)
    parts = [shapes.cylinder(0.03, h, 8)]
    for a in np.linspace(0, 2 * np.pi, n, endpoint=False) + rng.uniform(0, 6):
        tip = [r * np.cos(a), r * np.sin(a), 0.06]
        parts.append(shapes.tube([[0, 0, 0.12], tip], [0.03, 0.018], 6))
        parts.append(moved(shapes.superquadric([0.03, 0.03, 0.03], 1, 1, 5, 6), [*tip[:2], 0.03]))
    return parts


def sofa(rng: np.random.Generator) -> Piece:
    """Sofa or armchair: base, seat and back cushions, arms, loose pillows."""
    seats = int(rng.integers(1, 4))
    each, d = rng.uniform(0.55, 0.75), rng.uniform(0.75, 1.0)
    w, base, soft = seats * each, rng.uniform(0.2, 0.34), rng.uniform(0.15, 0.6)
    arm_w, back_h, arm_h = (
        rng.uniform(0.08, 0.25),
        rng.uniform(0.65, 1.0),
        rng.uniform(0.48, 0.7),
    )
    parts = [shapes.box([w, d, base - 0.06], [0, 0, 0.03 + 0.5 * base])]
    for k in range(seats):
        x = (k - 0.5 * (seats - 1)) * each
        tall = rng.uniform(0.12, 0.2)
        parts.append(
            shapes.cushion([each * 0.98, d * 0.78, tall], [x, 0.1 * d, base + 0.4 * tall], soft)
        )
        tilt = rng.uniform(0.05, 0.35)
        pad = shapes.cushion([each * 0.95, 0.2, back_h - base], [0, 0, 0], soft)
        parts.append(moved(pad, [x, -0.3 * d, 0.5 * (base + back_h)], rot_x(tilt)))
    parts.append(shapes.cushion([w, 0.2, back_h], [0, -0.42 * d, 0.5 * back_h], 0.2))
    if rng.random() < 0.85:
        for side in (-1, 1):
            x = side * 0.5 * (w + arm_w)
            parts.append(shapes.cushion([arm_w, d, arm_h], [x, 0, 0.5 * arm_h], soft))
    for _ in range(rng.integers(0, 4)):
        pillow = shapes.superquadric(rng.uniform([0.15, 0.05, 0.12], [0.28, 0.12, 0.25]), 0.6, 0.7)
        R = rot_z(rng.uniform(-0.6, 0.6)) @ rot_x(rng.uniform(0.0, 0.6))
        x = rng.uniform(-0.45, 0.45) * w
        parts.append(moved(pillow, [x, rng.uniform(-0.2, 0.1) * d, base + 0.3], R))
    surface = Surface(0, 0.15 * d, base + 0.17, 0.8 * w, 0.4 * d)
    return Piece(merge(parts), (surface,) if rng.random() < 0.5 else (), wall=rng.random() < 0.75)


def bed(rng: np.random.Generator) -> Piece:
    """Bed: frame, mattress, crumpled blanket, pillows, headboard."""
    w, d, h = rng.uniform(0.85, 1.9), rng.uniform(1.9, 2.15), rng.uniform(0.3, 0.6)
    thick = rng.uniform(0.14, 0.28)
    parts = [
        shapes.box([w, d, rng.uniform(0.08, 0.2)], [0, 0, h - thick - 0.04]),
        shapes.cushion([w, d, thick], [0, 0, h - 0.5 * thick], 0.15),
    ]
    parts += [
        shapes.box([0.07, 0.07, h - thick], [sx * 0.46 * w, sy * 0.46 * d, 0.5 * (h - thick)])
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    cover = shapes.sheet(rng, (1.05 * w, rng.uniform(0.5, 0.8) * d), 0.035, 0.1, (0.2, 0.9))
    parts.append(turned(cover, rng.uniform(-0.25, 0.25), [0, 0.15 * d, h + 0.05]))
    for _ in range(rng.integers(1, 5)):
        pillow = shapes.superquadric(rng.uniform([0.2, 0.14, 0.05], [0.36, 0.25, 0.1]), 0.7, 0.6)
        place = [rng.uniform(-0.3, 0.3) * w, -0.36 * d, h + 0.08]
        parts.append(turned(pillow, rng.uniform(-0.4, 0.4), place))
    if rng.random() < 0.8:
        tall = rng.uniform(0.7, 1.3)
        parts.append(shapes.box([w, 0.06, tall], [0, -0.5 * d - 0.03, 0.5 * tall]))
    return Piece(merge(parts), (Surface(0, 0.2 * d, h + 0.08, 0.8 * w, 0.4 * d),), wall=True)


def desk(rng: np.random.Generator) -> Piece:
    """Desk with drawers, screens, keyboard, paper stacks and cables."""
    w, d, h = rng.uniform(1.0, 2.0), rng.uniform(0.55, 0.9), rng.uniform(0.68, 0.8)
    parts = [shapes.box([w, d, 0.03], [0, 0, h - 0.015]), *_legs(rng, w, d, h - 0.03)]
    if rng.random() < 0.6:
        side = rng.choice([-1, 1])
        drawers = h - rng.uniform(0.1, 0.2)
        x = side * 0.32 * w
        parts.append(shapes.box([0.4, 0.9 * d, drawers - 0.03], [x, 0, 0.5 * drawers]))
        parts += [
            shapes.box([0.12, 0.03, 0.02], [x, 0.46 * d, q * drawers]) for q in (0.3, 0.55, 0.85)
        ]
    for k in range(rng.integers(1, 4)):
        parts.append(_screen(rng, (k - 0.7) * rng.uniform(0.45, 0.6), -0.2 * d, h))
    keyboard = shapes.box(rng.uniform([0.3, 0.1, 0.015], [0.46, 0.16, 0.03]))
    parts.append(turned(keyboard, rng.uniform(-0.4, 0.4), [0, 0.22 * d, h + 0.015]))
    if rng.random() < 0.5:
        panel = rng.uniform(0.25, 0.6)
        parts.append(shapes.box([w, 0.03, panel], [0, -0.5 * d, h + 0.3 * panel]))
    surface = Surface(0, 0.05 * d, h, 0.9 * w, 0.75 * d)
    return Piece(merge(parts), (surface,), wall=rng.random() < 0.7)


def _screen(rng: np.random.Generator, x: float, y: float, z: float) -> Mesh:
    """Monitor or open laptop standing on height z."""
    w = rng.uniform(0.35, 0.8)
    h = w * rng.uniform(0.5, 0.65)
    if rng.random() < 0.3:
        lid = moved(shapes.box([w, 0.012, h], [0, 0, 0.5 * h]), R=rot_x(rng.uniform(0.0, 0.5)))
        laptop = merge([lid, shapes.box([w, h, 0.02], [0, 0.5 * h, 0.01])])
        return turned(laptop, rng.uniform(-0.4, 0.4), [x, y, z])
    foot = shapes.cylinder(rng.uniform(0.08, 0.14), 0.015)
    neck = shapes.box([0.05, 0.03, 0.25], [0, -0.02, 0.12])
    curve = rng.uniform(0.0, 0.08)
    u = np.linspace(-0.5, 0.5, 7)
    arc: NDArray[np.float64] = np.stack([u * w, 4 * curve * u**2, 0 * u], 1)
    panel = shapes.grid(np.stack([arc + np.array([0, 0.02, 0]), arc + np.array([0, 0.02, h])]))
    shell = shapes.box([0.5 * w, 0.05, 0.6 * h], [0, -0.02, 0.5 * h])
    screen = merge([moved(merge([panel, shell]), [0, 0, rng.uniform(0.08, 0.2)]), foot, neck])
    return turned(screen, rng.uniform(-0.4, 0.4), [x, y, z])
