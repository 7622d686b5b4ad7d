# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Parametric solids and surfaces as triangle meshes."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.meshes.geometry import SmoothNoise
from hybridreg_ros.data.meshes.scene import Mesh, merge

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    F64 = NDArray[np.float64]

_BOX_FACES = np.array(
    [
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ],
    np.int32,
)  # fmt: skip
_BOX_CORNERS = np.array(
    [[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)], np.float32
)


def box(size: ArrayLike, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Mesh:
    """Axis-aligned box of a size (3,) about a centre (3,), metres."""
    v = _BOX_CORNERS * np.asarray(size, np.float32) + np.asarray(centre, np.float32)
    return Mesh(v, _BOX_FACES)


def grid(points: F64, *, wrap_u: bool = False, wrap_v: bool = False) -> Mesh:
    """Triangles over a grid of points (U, V, 3); a wrapped side joins its ends."""
    nu, nv = points.shape[:2]
    return Mesh(points.reshape(-1, 3).astype(np.float32), _grid_faces(nu, nv, wrap_u, wrap_v))


@lru_cache(maxsize=1024)
def _grid_faces(nu: int, nv: int, wrap_u: bool, wrap_v: bool) -> NDArray[np.int32]:
    """Triangles (F, 3) of a grid; shared by all grids of that size, so never written to."""
    u = np.arange(nu if wrap_u else nu - 1)
    v = np.arange(nv if wrap_v else nv - 1)
    a = (u[:, None] * nv + v[None, :]).ravel()
    b = (((u + 1) % nu)[:, None] * nv + v[None, :]).ravel()
    c = (((u + 1) % nu)[:, None] * nv + ((v + 1) % nv)[None, :]).ravel()
    d = (u[:, None] * nv + ((v + 1) % nv)[None, :]).ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    faces.setflags(write=False)
    return faces


def rings(loops: F64, *, capped: bool = True) -> Mesh:
    """Skin over closed loops (U, V, 3); caps are fans about the mean of the end loops."""
    if not capped:
        return grid(loops, wrap_v=True)
    vertices = np.empty((loops.shape[0] * loops.shape[1] + 2, 3), np.float32)
    vertices[:-2] = loops.reshape(-1, 3)
    vertices[-2], vertices[-1] = loops[0].mean(0), loops[-1].mean(0)
    return Mesh(vertices, _ring_faces(*loops.shape[:2]))


@lru_cache(maxsize=1024)
def _ring_faces(nu: int, nv: int) -> NDArray[np.int32]:
    """Triangles (F, 3) of capped rings; shared, so never written to."""
    i = np.arange(nv)
    j = (i + 1) % nv
    low = np.stack([np.full(nv, nu * nv), i, j], 1)
    high = np.stack([np.full(nv, nu * nv + 1), (nu - 1) * nv + j, (nu - 1) * nv + i], 1)
    skin = _grid_faces(nu, nv, False, True)
    faces = np.concatenate([skin, low, high]).astype(np.int32)
    faces.setflags(write=False)
    return faces


def lathe(profile: ArrayLike, segments: int = 14) -> Mesh:
    """Solid of revolution about z from a profile (n, 2) of radius and height, metres."""
    p = np.asarray(profile, np.float64)
    angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    x = p[:, None, 0] * np.cos(angle)
    y = p[:, None, 0] * np.sin(angle)
    return rings(np.stack([x, y, np.broadcast_to(p[:, None, 1], x.shape)], -1))


def cylinder(radius: float, height: float, segments: int = 14) -> Mesh:
    """Cylinder standing on z = 0, metres."""
    return lathe([[radius, 0.0], [radius, height]], segments)


def extrusion(
    outline: ArrayLike, height: float, *, top_scale: float = 1.0, twist_rad: float = 0.0
) -> Mesh:
    """Prism over a star-shaped outline (n, 2), standing on z = 0, tapered and twisted upwards."""
    p = np.asarray(outline, np.float64)
    levels = 2 if abs(twist_rad) < 1e-6 else 6
    loops = []
    for s in np.linspace(0.0, 1.0, levels):
        c, q = np.cos(s * twist_rad), np.sin(s * twist_rad)
        xy = (p @ np.array([[c, q], [-q, c]])) * (1.0 + s * (top_scale - 1.0))
        loops.append(np.column_stack([xy, np.full(len(p), s * height)]))
    return rings(np.stack(loops))


def superquadric(radii: ArrayLike, e1: float, e2: float, nu: int = 9, nv: int = 14) -> Mesh:
    """Superquadric about the origin: e = 1 is an ellipsoid, e towards 0 a rounded box."""
    eta = np.linspace(-0.5 * np.pi, 0.5 * np.pi, nu)[:, None]
    omega = np.linspace(-np.pi, np.pi, nv, endpoint=False)[None, :]

    def power(x: F64, e: float) -> F64:
        result: F64 = np.sign(x) * np.abs(x) ** e
        return result

    x = power(np.cos(eta), e1) * power(np.cos(omega), e2)
    y = power(np.cos(eta), e1) * power(np.sin(omega), e2)
    z = np.broadcast_to(power(np.sin(eta), e1), x.shape)
    return rings(np.stack([x, y, z], -1) * np.asarray(radii, np.float64))


def cushion(size: ArrayLike, centre: ArrayLike, softness: float = 0.3) -> Mesh:
    """Rounded box of a size (3,) about a centre (3,)."""
    mesh = superquadric(0.5 * np.asarray(size, np.float64), softness, softness)
    return Mesh(mesh.vertices + np.asarray(centre, np.float32), mesh.faces)


def blob(rng: np.random.Generator, radius: float, roughness: float = 0.25) -> Mesh:
    """Ball whose radius follows smooth noise of relative amplitude `roughness`."""
    ball = superquadric([1.0, 1.0, 1.0], 1.0, 1.0, 11, 16).vertices
    noise = SmoothNoise(rng, (0.7, 3.0), roughness)
    scale = radius * np.clip(1.0 + noise(ball.astype(np.float64)), 0.3, 2.0)
    faces = superquadric([1.0, 1.0, 1.0], 1.0, 1.0, 11, 16).faces
    return Mesh((ball * scale[:, None]).astype(np.float32), faces)


def tube(path: ArrayLike, radius: ArrayLike, segments: int = 8) -> Mesh:
    """Round tube along a path (n, 3) with one radius or one per path point, ends capped."""
    p = np.asarray(path, np.float64)
    r = np.broadcast_to(np.asarray(radius, np.float64), (len(p),))
    tangent = np.gradient(p, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    first, second = _frames(tangent)
    across = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    return rings(p[:, None] + r[:, None, None] * across)


def _frames(tangent: F64) -> tuple[F64, F64]:
    """Two unit vectors (n, 3) across each unit tangent, that turn as little as they can."""
    seed = tuple(np.eye(3)[np.argmin(np.abs(tangent[0]))].tolist())
    first, second = [], []
    for t in tangent.tolist():
        a = _cross(t, seed)
        size = max((a[0] * a[0] + a[1] * a[1] + a[2] * a[2]) ** 0.5, 1e-9)
        a = (a[0] / size, a[1] / size, a[2] / size)
        first.append(a)
        second.append(_cross(t, a))
        seed = _cross(a, t)
    return np.array(first), np.array(second)


def _cross(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float]:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def torus(major: float, minor: float, nu: int = 16, nv: int = 8) -> Mesh:
    """Torus about z at the origin, metres."""
    u = np.linspace(0.0, 2.0 * np.pi, nu, endpoint=False)[:, None]
    v = np.linspace(0.0, 2.0 * np.pi, nv, endpoint=False)[None, :]
    ring = major + minor * np.cos(v)
    z = np.broadcast_to(minor * np.sin(v), ring.shape) + 0.0 * u
    return grid(np.stack([ring * np.cos(u), ring * np.sin(u), z], -1), wrap_u=True, wrap_v=True)


def sheet(
    rng: np.random.Generator,
    size: tuple[float, float],
    roughness_m: float,
    cell_m: float = 0.3,
    wavelength_m: tuple[float, float] = (0.6, 4.0),
) -> Mesh:
    """Nearly flat patch in x, y about the origin; z follows smooth noise."""
    nx = max(2, 1 + round(size[0] / cell_m))
    ny = max(2, 1 + round(size[1] / cell_m))
    x, y = np.meshgrid(
        np.linspace(-0.5, 0.5, nx) * size[0],
        np.linspace(-0.5, 0.5, ny) * size[1],
        indexing='ij',
    )
    z = SmoothNoise(rng, wavelength_m, roughness_m, dim=2)(np.stack([x.ravel(), y.ravel()], 1))
    return grid(np.stack([x, y, z.reshape(x.shape)], -1))


def star_outline(rng: np.random.Generator, radius: float, n: int = 20) -> F64:
    """Random smooth star-shaped outline (n, 2) of a mean radius, metres."""
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    r = np.ones(n)
    for k in range(2, 6):
        r += rng.normal(0.0, 0.35 / k) * np.cos(k * angle + rng.uniform(0.0, 2.0 * np.pi))
    r = radius * np.clip(r, 0.35, 1.8)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)])


def random_profile(rng: np.random.Generator, radius: float, height: float, n: int = 9) -> F64:
    """Random vase-like profile (n, 2) of radius and height, metres."""
    s = np.linspace(0.0, 1.0, n)
    r = 0.65 + sum(
        rng.normal(0.0, 0.28 / k) * np.cos(np.pi * k * s + rng.uniform(0.0, 2.0 * np.pi))
        for k in range(1, 5)
    )
    return np.column_stack([radius * np.clip(r, 0.12, 1.0), s * height])


def frame(width: float, height: float, depth: float, bar: float) -> Mesh:
    """Rectangular frame in x, z about the origin: four bars."""
    w, h = 0.5 * width, 0.5 * height
    return merge(
        [
            box([width, depth, bar], [0.0, 0.0, h - 0.5 * bar]),
            box([width, depth, bar], [0.0, 0.0, -h + 0.5 * bar]),
            box([bar, depth, height], [w - 0.5 * bar, 0.0, 0.0]),
            box([bar, depth, height], [-w + 0.5 * bar, 0.0, 0.0]),
        ]
    )
