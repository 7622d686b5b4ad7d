# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Lofted skin: closed tubes and balls held by bones, the pieces a body is made of."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.bodies.rig import Part
from hybridreg_ros.data.meshes.geometry import cross

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    F64 = NDArray[np.float64]
    I64 = NDArray[np.int64]


@lru_cache(maxsize=512)
def tube_faces(rings: int, sides: int) -> I64:
    """Faces of a closed tube: `rings` rings of `sides` vertices, then two cap centres."""
    ring, side = np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing='ij')
    a, b = ring * sides + side, ring * sides + (side + 1) % sides
    quads = [np.stack([a, b, b + sides], -1), np.stack([a, b + sides, a + sides], -1)]
    k = np.arange(sides)
    first, last = rings * sides, rings * sides + 1
    top = (rings - 1) * sides
    caps = [
        np.stack([(k + 1) % sides, k, np.full(sides, first)], -1),
        np.stack([top + k, top + (k + 1) % sides, np.full(sides, last)], -1),
    ]
    faces = np.concatenate([q.reshape(-1, 3) for q in quads] + caps).astype(np.int64)
    faces.setflags(write=False)
    return faces


@lru_cache(maxsize=512)
def _stations(rings: int) -> F64:
    """Parameters in [0, 1], denser towards both ends so that the caps come out round."""
    x: F64 = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0.02, 0.98, rings))
    return 0.55 * x + 0.45 * np.linspace(0.0, 1.0, rings)


def loft(  # noqa: PLR0913 - a drawing tool
    path: Sequence[Sequence[float] | F64] | F64,
    radii: Sequence[Sequence[float]] | F64,
    bones: Sequence[int],
    *,
    rings: int = 10,
    sides: int = 12,
    side_axis: tuple[float, float, float] = (0.0, 1.0, 0.0),
    square: float = 2.0,
    blend_m: float = 0.05,
    rng: np.random.Generator | None = None,
    lumps: float = 0.0,
) -> Part:
    """Closed tube along a polyline of the rest pose, with round ends, held by a chain of bones.

    Args:
        path: (P, 3) centre line; inner points are the joints between consecutive bones when
            len(bones) == P - 1, otherwise `bones` must hold one bone.
        radii: (K, 2) half width along `side_axis` and across it, evenly spread from end to end.
        bones: the bones along the path.
        rings: rings of vertices.
        sides: vertices of a ring.
        side_axis: direction of the first radius.
        square: exponent of the superellipse, 2 = ellipse, larger = boxier.
        blend_m: half length of the blend around a joint, metres.
        rng: source of the lumps.
        lumps: relative size of low-frequency bumps (folds, muscles, fur).
    """
    corner = np.asarray(path, dtype=np.float64)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corner, axis=0), axis=1))])
    u = _stations(rings)
    s = u * along[-1]
    centre = np.stack([np.interp(s, along, corner[:, k]) for k in range(3)], axis=1)
    profile = np.asarray(radii, dtype=np.float64)
    knots = np.linspace(0.0, 1.0, len(profile))
    r = np.stack([np.interp(u, knots, profile[:, k]) for k in (0, 1)], axis=1)
    end = np.minimum(s, along[-1] - s)
    cap = np.clip(end / np.maximum(np.minimum(r.max(axis=1), 0.3 * along[-1]), 1e-6), 0.0, 1.0)
    r = r * np.sqrt(1.0 - (1.0 - 0.97 * cap) ** 2)[:, None]
    vertices = _rings(centre, r, np.asarray(side_axis), sides, square)
    if rng is not None and lumps > 0.0:
        vertices = _lumpy(vertices, centre, u, rng, lumps)
    caps = centre[[0, -1]]
    a, b, w = _weights(s, along, bones, blend_m)
    every = np.concatenate([vertices.reshape(-1, 3), caps])
    owner = np.append(np.repeat(np.arange(rings), sides), [0, rings - 1])
    return Part(every, tube_faces(rings, sides), a[owner], b[owner], w[owner], (rings, sides))


def _rings(centre: F64, r: F64, side_axis: F64, sides: int, square: float) -> F64:
    """Superellipse rings (rings, sides, 3) perpendicular to the centre line."""
    tangent = np.gradient(centre, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    first = side_axis - tangent * (tangent @ side_axis)[:, None]
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-9)
    second = cross(tangent, first)
    phi = 2.0 * np.pi * np.arange(sides) / sides
    c, s = np.cos(phi), np.sin(phi)
    x = np.sign(c) * np.abs(c) ** (2.0 / square)
    y = np.sign(s) * np.abs(s) ** (2.0 / square)
    across = x[None, :, None] * (r[:, :1] * first)[:, None]
    ringed: F64 = centre[:, None] + across + y[None, :, None] * (r[:, 1:] * second)[:, None]
    return ringed


def _lumpy(vertices: F64, centre: F64, u: F64, rng: np.random.Generator, size: float) -> F64:
    """Rings pushed in and out by a few random waves around and along the tube."""
    phi = 2.0 * np.pi * np.arange(vertices.shape[1]) / vertices.shape[1]
    k, m = rng.integers(1, 5, 4), rng.uniform(0.0, 14.0, 4)
    shift = rng.uniform(0.0, 2.0 * np.pi, 4)
    waves = np.sin(k * phi[None, :, None] + m * u[:, None, None] + shift).sum(axis=-1)
    out: F64 = centre[:, None] + (vertices - centre[:, None]) * (
        1.0 + 0.6 * size * waves[..., None]
    )
    return out


def _weights(s: F64, along: F64, bones: Sequence[int], blend_m: float) -> tuple[I64, I64, F64]:
    """Two bones and the second one's share for each station (S,)."""
    chain = np.asarray(bones, dtype=np.int64)
    if len(chain) == 1:
        one = np.full(len(s), chain[0])
        return one, one, np.zeros(len(s))
    joints = along[1:-1]
    nearest = np.abs(s[:, None] - joints).argmin(axis=1)
    x = np.clip(0.5 + (s - joints[nearest]) / (2.0 * blend_m), 0.0, 1.0)
    return chain[nearest], chain[nearest + 1], x * x * (3.0 - 2.0 * x)


def ball(
    centre: ArrayLike,
    radii: ArrayLike,
    bone: int,
    *,
    square: float = 2.0,
    rings: int = 8,
    sides: int = 12,
) -> Part:
    """Ellipsoid (or rounder box with a larger exponent) of half axes `radii` on one bone."""
    x, y, z = np.asarray(centre, dtype=np.float64)
    a, b, c = np.asarray(radii, dtype=np.float64)
    u = np.linspace(-0.98, 0.98, rings) * np.pi / 2.0
    flat = np.cos(u) ** (2.0 / square)
    up = np.sign(u) * np.abs(np.sin(u)) ** (2.0 / square)
    line = np.stack([np.full(rings, x), np.full(rings, y), z + c * up], axis=1)
    phi = 2.0 * np.pi * np.arange(sides) / sides
    cs, sn = np.cos(phi), np.sin(phi)
    ring_x = a * np.sign(cs) * np.abs(cs) ** (2.0 / square)
    ring_y = b * np.sign(sn) * np.abs(sn) ** (2.0 / square)
    ring = np.stack([ring_x, ring_y, np.zeros(sides)], axis=1)
    vertices = line[:, None] + flat[:, None, None] * ring
    every = np.concatenate([vertices.reshape(-1, 3), line[[0, -1]]])
    held = np.full(len(every), bone)
    return Part(every, tube_faces(rings, sides), held, held, np.zeros(len(every)), (rings, sides))


def coarser(part: Part) -> Part:
    """The same tube with half the rings and, where they are many, half the vertices of a ring."""
    rings, sides = part.rings
    ring = np.unique(np.append(np.arange(0, rings, 2), rings - 1))
    side = np.arange(0, sides, 2 if sides >= 10 else 1)
    kept = (ring[:, None] * sides + side).ravel()
    rows = np.concatenate([kept, rings * sides + np.arange(2)])
    return Part(
        part.vertices[rows],
        tube_faces(len(ring), len(side)),
        part.bone_a[rows],
        part.bone_b[rows],
        part.weight_b[rows],
        (len(ring), len(side)),
    )


def assemble(parts: Sequence[Part], *, coarse: bool = False) -> Part:
    """One skin of many pieces (closed pieces that run into each other, as limbs do).

    Args:
        parts: tubes and balls.
        coarse: about a quarter of the triangles, for bodies seen from some metres away.
    """
    if coarse:
        parts = [coarser(p) for p in parts]
    starts = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
    faces = np.concatenate([p.faces + k for p, k in zip(parts, starts, strict=True)])
    return Part(
        np.concatenate([p.vertices for p in parts]),
        faces.astype(np.int32),
        np.concatenate([p.bone_a for p in parts]),
        np.concatenate([p.bone_b for p in parts]),
        np.concatenate([p.weight_b for p in parts]),
    )
