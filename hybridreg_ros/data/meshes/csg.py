# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Free-form objects: boolean combinations of primitives as distance fields, and deformations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.meshes import shapes
from hybridreg_ros.data.meshes.geometry import SmoothNoise, fitted, moved, random_rotation
from hybridreg_ros.data.meshes.scene import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

_EDGES = [
    (a, a + step)
    for axis, step in enumerate((4, 2, 1))
    for a in range(8)
    if not a >> (2 - axis) & 1
]
_CORNERS = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)])


def isosurface(field: F64) -> Mesh:
    """Zero set of a sampled field (n, n, n), inside negative, as naive surface nets.

    Vertices are in cells of the grid, from 0 to n - 1. The field must be positive at its border.
    """
    n = np.array(field.shape) - 1
    corner = np.stack(
        [field[i : n[0] + i, j : n[1] + j, k : n[2] + k] for i, j, k in _CORNERS], -1
    )
    inside = corner < 0.0
    active = inside.any(-1) & ~inside.all(-1)
    cells = np.argwhere(active)
    values = corner[active]
    total = np.zeros((len(cells), 3))
    count = np.zeros(len(cells))
    for a, b in _EDGES:
        va, vb = values[:, a], values[:, b]
        cut = (va < 0.0) != (vb < 0.0)
        s = np.where(cut, va / np.where(cut, va - vb, 1.0), 0.0)
        total += cut[:, None] * (_CORNERS[a] + s[:, None] * (_CORNERS[b] - _CORNERS[a]))
        count += cut
    vertices = cells + total / np.maximum(count, 1.0)[:, None]
    number = np.full(active.shape, -1, np.int64)
    number[active] = np.arange(len(cells))
    faces = [_edge_quads(field, number, axis) for axis in range(3)]
    return Mesh(vertices.astype(np.float32), np.concatenate(faces).astype(np.int32))


def _edge_quads(field: F64, number: NDArray[np.int64], axis: int) -> NDArray[np.int64]:
    """Two triangles for every grid edge along `axis` that crosses the surface."""
    sign = np.moveaxis(field < 0.0, axis, 0)
    number = np.moveaxis(number, axis, 0)
    i, j, k = np.nonzero((sign[:-1] != sign[1:])[:, 1:-1, 1:-1])
    quad = [number[i, j + a, k + b] for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
    # Counter-clockwise seen from outside: the order turns with the side that is inside.
    turned = sign[:-1][:, 1:-1, 1:-1][i, j, k] != (axis == 1)
    second, last = np.where(turned, quad[1], quad[3]), np.where(turned, quad[3], quad[1])
    return np.concatenate(
        [np.stack([quad[0], second, quad[2]], 1), np.stack([quad[0], quad[2], last], 1)]
    )


def _primitive(rng: np.random.Generator, p: F64) -> F64:
    """Approximate signed distance (N,) of points (N, 3) to a random primitive near the origin."""
    q = (p - rng.uniform(-0.4, 0.4, 3)) @ random_rotation(rng)
    size = rng.uniform(0.15, 0.6, 3)
    kind = rng.integers(5)
    if kind == 0:
        d = np.abs(q) - size
        return np.asarray(np.linalg.norm(np.maximum(d, 0.0), axis=1) + np.minimum(d.max(1), 0.0))
    if kind == 1:
        scaled = np.linalg.norm(q / size, axis=1)
        return np.asarray((scaled - 1.0) * size.min())
    radial = np.linalg.norm(q[:, :2], axis=1)
    if kind == 2:
        return np.asarray(np.maximum(radial - 0.7 * size[0], np.abs(q[:, 2]) - size[2]))
    if kind == 3:
        ring = np.hypot(radial - 0.7, q[:, 2])
        return np.asarray(ring - 0.35 * size[0])
    axis = np.clip(q[:, 2], -size[2], size[2])
    return np.asarray(np.hypot(radial, q[:, 2] - axis) - 0.5 * size[0])


def csg(rng: np.random.Generator, resolution: int = 18) -> Mesh:
    """Random solid inside [-1, 1]: unions, cuts, blends and shells of two to four primitives."""
    axis = np.linspace(-1.15, 1.15, resolution)
    p = np.stack(np.meshgrid(axis, axis, axis, indexing='ij'), -1).reshape(-1, 3)
    d = _primitive(rng, p)
    for _ in range(rng.integers(1, 4)):
        other = _primitive(rng, p)
        kind = rng.random()
        if kind < 0.45:
            d = np.minimum(d, other)
        elif kind < 0.7:
            cut = np.maximum(d, -other)
            d = cut if (cut < 0.0).sum() > 30 else np.minimum(d, other)
        else:
            k = rng.uniform(0.1, 0.4)
            h = np.clip(0.5 + 0.5 * (other - d) / k, 0.0, 1.0)
            d = other + h * (d - other) - k * h * (1.0 - h)
    if rng.random() < 0.3:
        d = d + SmoothNoise(rng, (0.3, 1.2), 0.05)(p)
    field = d.reshape((resolution,) * 3).copy()
    for side in (0, -1):
        field[side], field[:, side], field[:, :, side] = 0.1, 0.1, 0.1
    if (field < 0.0).sum() < 8:
        return shapes.blob(rng, 0.8)
    return moved(isosurface(field), (-1.0, -1.0, -1.0), None, 2.0 / (resolution - 1))


def deformed(rng: np.random.Generator, mesh: Mesh) -> Mesh:
    """Mesh twisted about z, tapered along z and bent, each at random, relative to its size."""
    v = mesh.vertices.astype(np.float64)
    low, high = v.min(0), v.max(0)
    s = (v[:, 2] - low[2]) / max(high[2] - low[2], 1e-6)
    if rng.random() < 0.4:
        v[:, :2] *= (1.0 + rng.uniform(-0.5, 0.5) * s)[:, None]
    if rng.random() < 0.3:
        a = rng.uniform(-1.2, 1.2) * s
        x, y = v[:, 0].copy(), v[:, 1].copy()
        v[:, 0], v[:, 1] = np.cos(a) * x - np.sin(a) * y, np.sin(a) * x + np.cos(a) * y
    if rng.random() < 0.3:
        v[:, 0] += rng.uniform(-0.4, 0.4) * (high[0] - low[0]) * s**2
    return Mesh(v.astype(np.float32), mesh.faces)


def _wire(rng: np.random.Generator) -> Mesh:
    """A bent tube, like a cable, a branch or a handle."""
    s = np.linspace(0.0, 1.0, 9)[:, None]
    path = s * rng.normal(size=3) + 0.5 * np.sin(np.pi * rng.uniform(0.5, 2.5) * s) * rng.normal(
        size=3
    )
    return shapes.tube(path, rng.uniform(0.03, 0.2), 7)


def free_form(rng: np.random.Generator, size_m: float) -> Mesh:
    """Random object standing on z = 0 whose longest side is `size_m`, from all shape families."""
    kind = rng.choice(8, p=[0.14, 0.14, 0.12, 0.12, 0.1, 0.22, 0.08, 0.08])
    if kind == 0:
        mesh = shapes.superquadric([1.0, 1.0, 1.0], *rng.uniform(0.15, 1.8, 2))
    elif kind == 1:
        mesh = shapes.lathe(shapes.random_profile(rng, 1.0, rng.uniform(0.5, 3.0)))
    elif kind == 2:
        outline = shapes.star_outline(rng, 1.0)
        twist = rng.choice([0.0, rng.uniform(-1.5, 1.5)])
        mesh = shapes.extrusion(
            outline, rng.uniform(0.3, 2.5), top_scale=rng.uniform(0.4, 1.2), twist_rad=twist
        )
    elif kind == 3:
        mesh = shapes.blob(rng, 1.0, rng.uniform(0.1, 0.4))
    elif kind == 4:
        mesh = shapes.box(rng.uniform(0.2, 1.0, 3))
    elif kind == 5:
        mesh = csg(rng)
    elif kind == 6:
        mesh = shapes.torus(1.0, rng.uniform(0.15, 0.5))
    else:
        mesh = _wire(rng)
    if kind != 5:
        mesh = deformed(rng, mesh)
    if rng.random() < 0.5:
        mesh = moved(mesh, R=random_rotation(rng))
    extent = np.ptp(mesh.vertices, axis=0) * rng.uniform(0.5, 1.0, 3)
    return fitted(mesh, size_m * np.maximum(extent / extent.max(), 0.08))
