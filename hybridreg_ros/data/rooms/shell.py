# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The shell of a room: uneven walls with doors, windows and niches, floor, ceiling, fittings."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hybridreg_ros.data.meshes import shapes
from hybridreg_ros.data.meshes.csg import free_form
from hybridreg_ros.data.meshes.geometry import SmoothNoise, moved, turned
from hybridreg_ros.data.meshes.scene import Mesh, merge

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.rooms.floor import Plan

    F64 = NDArray[np.float64]


class Part(NamedTuple):
    """Static triangles of one thing.

    Attributes:
        mesh: triangles, room frame, metres.
        plane: number of the large plane they belong to, from 1; 0 for everything else.
        loss: share of rays that never return (dark, shiny or transparent material).
    """

    mesh: Mesh
    plane: int = 0
    loss: float = 0.0


class Hole(NamedTuple):
    """A rectangle cut out of a wall: extent along the wall and in height, metres."""

    kind: str
    left: float
    right: float
    low: float
    high: float


def build_shell(rng: np.random.Generator, plan: Plan) -> list[Part]:
    """Walls, floor, ceiling and what belongs to them; each large plane has its own number."""
    style = _Style(rng)
    parts: list[Part] = []
    corners = plan.outline
    for k, (a, b) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        length = float(np.linalg.norm(b - a))
        yaw = float(np.arctan2(b[1] - a[1], b[0] - a[0]))
        parts += [
            Part(turned(part.mesh, yaw, [*a, 0.0]), part.plane, part.loss)
            for part in _wall(rng, style, length, plan.height_m, k + 1)
        ]
    size = np.ptp(corners, axis=0)
    centre = 0.5 * (corners.max(0) + corners.min(0))
    beyond = (float(size[0] + 3.0), float(size[1] + 3.0))
    floor = shapes.sheet(rng, beyond, style.floor_m, 0.5)
    parts.append(Part(moved(floor, [*centre, 0.0]), len(corners) + 1))
    parts += _ceiling(rng, plan, beyond, len(corners) + 2)
    parts += _columns(rng, plan)
    return parts


class _Style:
    """What all walls of one room share."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.bump_m = float(rng.uniform(0.001, 0.012))
        self.floor_m = float(rng.uniform(0.001, 0.008))
        self.relief_m = float(rng.uniform(0.008, 0.04)) if rng.random() < 0.2 else 0.0
        self.relief_step_m = float(rng.uniform(0.12, 0.6))
        self.door_share = float(rng.uniform(0.2, 0.7))
        self.window_share = float(rng.uniform(0.0, 0.8))
        self.board_m = float(rng.uniform(0.05, 0.14)) if rng.random() < 0.7 else 0.0
        self.pane_loss = float(rng.choice([1.0, 0.9, 0.2]))
        self.sill_m = float(rng.uniform(0.1, 1.1))


def _holes(rng: np.random.Generator, style: _Style, length: float, height: float) -> list[Hole]:
    """Doors, windows and niches side by side along a wall."""
    holes = []
    at = rng.uniform(0.1, 0.8)
    while at < length - 0.7:
        pick = rng.random()
        if pick < 0.3 * style.door_share:
            hole = Hole('door', at, at + rng.uniform(0.75, 1.1), 0.0, min(2.1, height - 0.1))
        elif pick < 0.3 * style.door_share + 0.5 * style.window_share:
            top = min(height - 0.15, style.sill_m + rng.uniform(0.8, 1.7))
            hole = Hole('window', at, at + rng.uniform(0.5, 2.0), style.sill_m, top)
        elif pick < 0.3 * style.door_share + 0.5 * style.window_share + 0.12:
            low = rng.uniform(0.0, 1.2)
            high = min(height - 0.2, low + rng.uniform(0.4, 2.0))
            hole = Hole('niche', at, at + rng.uniform(0.3, 1.5), low, high)
        else:
            at += rng.uniform(0.4, 2.0)
            continue
        if hole.right > length - 0.15:
            break
        holes.append(hole)
        at = hole.right + rng.uniform(0.25, 1.5)
    return holes


def _wall(
    rng: np.random.Generator, style: _Style, length: float, height: float, plane: int
) -> list[Part]:
    """One wall along +x from the origin, the room on its +y side."""
    holes = _holes(rng, style, length, height)
    parts = [Part(_wall_face(rng, style, length, height, holes), plane)]
    for hole in holes:
        parts += _fill_hole(rng, style, hole)
    if style.board_m > 0.0:
        edges = [0.0, *(x for h in holes if h.low < 0.05 for x in (h.left, h.right)), length]
        for left, right in zip(edges[::2], edges[1::2], strict=True):
            size = [right - left, 0.02, style.board_m]
            parts.append(Part(shapes.box(size, [0.5 * (left + right), 0.01, 0.5 * size[2]])))
    return parts


def _wall_face(
    rng: np.random.Generator, style: _Style, length: float, height: float, holes: list[Hole]
) -> Mesh:
    """The uneven plane of a wall with its holes left open."""
    nx, nz = max(2, round(length / 0.4)), max(2, round(height / 0.5))
    xs = np.linspace(0.0, length, nx + 1)
    if style.relief_m > 0.0:
        xs = np.union1d(xs, np.arange(0.0, length, style.relief_step_m))
    xs = np.union1d(xs, [v for h in holes for v in (h.left, h.right)])
    zs = np.union1d(np.linspace(0, height, nz + 1), [v for h in holes for v in (h.low, h.high)])
    x, z = np.meshgrid(xs, zs, indexing='ij')
    y = SmoothNoise(rng, (0.8, 5.0), style.bump_m, dim=2)(np.stack([x.ravel(), z.ravel()], 1))
    y = y.reshape(x.shape)
    if style.relief_m > 0.0:
        steps = rng.normal(0.0, style.relief_m, 400)
        y += steps[np.floor(xs / style.relief_step_m + 1e-6).astype(int) % 400][:, None]
    face = shapes.grid(np.stack([x, y, z], -1))
    centre = face.vertices[face.faces].mean(1)
    keep = np.ones(len(face.faces), np.bool_)
    for h in holes:
        within = (centre[:, 0] > h.left) & (centre[:, 0] < h.right)
        keep &= ~(within & (centre[:, 2] > h.low) & (centre[:, 2] < h.high))
    return Mesh(face.vertices, face.faces[keep])


def _fill_hole(rng: np.random.Generator, style: _Style, hole: Hole) -> list[Part]:
    """Reveal of a hole, and the door, window or back panel in it."""
    w, h = hole.right - hole.left, hole.high - hole.low
    deep = rng.uniform(0.06, 0.3) if hole.kind != 'niche' else rng.uniform(0.15, 0.6)
    x, z = 0.5 * (hole.left + hole.right), 0.5 * (hole.low + hole.high)
    reveal = shapes.frame(w + 0.04, h + 0.04, deep, 0.02)
    parts = [Part(moved(reveal, [x, -0.5 * deep, z]))]
    if rng.random() < 0.6:
        trim = rng.uniform(0.04, 0.12)
        outer = shapes.frame(w + 2 * trim, h + 2 * trim, 0.03, trim)
        parts.append(Part(moved(outer, [x, 0.01, z])))
    if hole.kind == 'niche':
        parts.append(Part(shapes.box([w, 0.02, h], [x, -deep, z])))
        for low in np.arange(0.0, h - 0.2, rng.uniform(0.3, 0.6)):
            parts.append(Part(shapes.box([w, deep, 0.02], [x, -0.5 * deep, hole.low + low])))
            for _ in range(rng.integers(0, 4)):
                thing = free_form(rng, rng.uniform(0.1, 0.25))
                spot = [x + rng.uniform(-0.4, 0.4) * w, -0.5 * deep, hole.low + low + 0.01]
                parts.append(Part(moved(thing, spot)))
    elif hole.kind == 'window':
        parts += _window(rng, style, w, h, [x, -0.6 * deep, z])
    else:
        parts += _door(rng, hole, w, h, deep)
    return parts


def _window(
    rng: np.random.Generator, style: _Style, w: float, h: float, at: list[float]
) -> list[Part]:
    """Sashes with bars, a sill, and a pane that often loses rays."""
    n = max(1, round(w / rng.uniform(0.5, 0.9)))
    bar = rng.uniform(0.03, 0.08)
    sashes = [
        moved(shapes.frame(w / n, h, 0.05, bar), [(k + 0.5) * w / n - 0.5 * w, 0, 0])
        for k in range(n)
    ]
    if rng.random() < 0.4:
        sashes.append(shapes.box([w, 0.04, 0.5 * bar], [0, 0, rng.uniform(-0.2, 0.3) * h]))
    sill = shapes.box([w + 0.1, rng.uniform(0.1, 0.35), 0.03], [0, 0.12, -0.5 * h])
    pane = Part(moved(shapes.box([w, 0.01, h]), at), 0, style.pane_loss)
    parts = [Part(moved(merge([*sashes, sill]), at)), pane]
    if rng.random() < 0.3:
        slats = [
            shapes.box([w, 0.03, 0.008], [0, 0.06, z]) for z in np.arange(-0.5 * h, 0.5 * h, 0.06)
        ]
        parts.append(Part(moved(merge(slats), at)))
    return parts


def _door(rng: np.random.Generator, hole: Hole, w: float, h: float, deep: float) -> list[Part]:
    """A leaf that is shut or stands open; behind an open one lies another wall."""
    panels = [shapes.box([w, 0.04, h], [0.5 * w, 0, 0.5 * h])]
    for z in np.linspace(0.1, 0.9, rng.integers(2, 5))[:-1]:
        if rng.random() < 0.7:
            panel = shapes.frame(0.7 * w, 0.2 * h, 0.06, 0.03)
            panels.append(moved(panel, [0.5 * w, 0, (z + 0.12) * h]))
    panels.append(
        shapes.tube([[0.9 * w, 0.0, 1.0], [0.9 * w, 0.07, 1.0], [0.78 * w, 0.07, 1.0]], 0.012, 6)
    )
    leaf = merge(panels)
    if rng.random() < 0.45:
        return [Part(moved(leaf, [hole.left, -0.5 * deep, 0.0]))]
    swing = rng.uniform(0.3, 1.7)
    far = rng.uniform(0.9, 2.5)
    x = 0.5 * (hole.left + hole.right)
    behind = shapes.box([3.0, 0.05, 2.6], [x, -far, 1.3])
    things = [
        moved(free_form(rng, rng.uniform(0.3, 1.0)), [x + rng.uniform(-0.6, 0.6), -0.6 * far, 0])
    ]
    parts = [Part(behind), Part(merge(things))]
    if rng.random() < 0.75:
        parts.append(Part(turned(leaf, swing, [hole.left, 0.0, 0.0])))
    return parts


def _ceiling(
    rng: np.random.Generator, plan: Plan, size: tuple[float, float], plane: int
) -> list[Part]:
    """Ceiling, flat or sloping, with beams, ducts, lights; sometimes none."""
    if rng.random() < 0.12:
        return []
    centre = 0.5 * (plan.outline.max(0) + plan.outline.min(0))
    top = shapes.sheet(rng, size, rng.uniform(0.001, 0.006), 0.8)
    v = top.vertices.copy()
    if rng.random() < 0.15:
        v[:, 2] -= np.float32(rng.uniform(0.05, 0.35)) * np.maximum(v[:, 0], 0.0)
    parts = [Part(moved(Mesh(v, top.faces), [*centre, plan.height_m]), plane)]
    h, w, d = plan.height_m, size[0] - 3.0, size[1] - 3.0
    if rng.random() < 0.25:
        thick = rng.uniform(0.08, 0.3)
        rows = np.arange(-0.5 * d, 0.5 * d, rng.uniform(0.8, 2.0))
        beams = [shapes.box([w, thick, thick], [0, y, h - 0.5 * thick]) for y in rows]
        parts.append(Part(moved(merge(beams), [*centre, 0])))
    if rng.random() < 0.25:
        for _ in range(rng.integers(1, 4)):
            y, r = rng.uniform(-0.5, 0.5) * d, rng.uniform(0.03, 0.2)
            path = [[-0.5 * w, y, h - r - 0.05], [0.5 * w, y, h - r - 0.05]]
            parts.append(Part(moved(shapes.tube(path, r), [*centre, 0])))
    for _ in range(rng.integers(0, 3 + int(0.06 * w * d))):
        spot = [*(centre + rng.uniform(-0.45, 0.45, 2) * [w, d]), 0.0]
        parts.append(Part(moved(_light(rng, h), spot)))
    return parts


def _light(rng: np.random.Generator, h: float) -> Mesh:
    """Ceiling panel, globe or hanging lamp below height h."""
    kind = rng.integers(3)
    if kind == 0:
        return shapes.box(rng.uniform([0.3, 0.3, 0.04], [1.3, 0.6, 0.1]), [0, 0, h - 0.04])
    drop = rng.uniform(0.05, 1.0) if kind == 1 else 0.0
    shade = shapes.lathe(shapes.random_profile(rng, rng.uniform(0.1, 0.35), 0.25, 7))
    cord = shapes.tube([[0, 0, h - drop - 0.1], [0, 0, h]], 0.01, 5)
    return merge([moved(shade, [0, 0, h - drop - 0.3]), cord])


def _columns(rng: np.random.Generator, plan: Plan) -> list[Part]:
    """Pillars along the walls of any room, and free-standing ones in large rooms."""
    parts = []
    corners = plan.outline
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if rng.random() < 0.12:
            spot = a + rng.uniform(0.15, 0.85) * (b - a)
            w, d = rng.uniform(0.2, 0.7, 2)
            yaw = float(np.arctan2(b[1] - a[1], b[0] - a[0]))
            pillar = shapes.box([w, 2 * d, plan.height_m], [0, 0, 0.5 * plan.height_m])
            parts.append(Part(turned(pillar, yaw, [*spot, 0.0])))
    return parts
