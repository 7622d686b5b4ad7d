# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What grows outdoors, and the rough ground below: trees, bushes, hedges, rocks, terrain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.meshes.geometry import SmoothNoise, cross, moved
from hybridreg_ros.data.meshes.scene import Mesh, merge
from hybridreg_ros.data.meshes.shapes import blob, grid, tube

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from hybridreg_ros.data.bodies.track import Track

    F64 = NDArray[np.float64]


def foliage(rng: np.random.Generator, points: F64, size_m: float) -> Mesh:
    """A loose cloud of leaf clusters: one random quad about each point (N, 3).

    Rays pass between them, so that a lidar sees into the crown as it does in a real one.
    """
    n = len(points)
    a = rng.normal(size=(n, 3))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = cross(a, rng.normal(size=(n, 3)))
    b /= np.maximum(np.linalg.norm(b, axis=1, keepdims=True), 1e-9)
    half = size_m * rng.uniform(0.3, 0.8, (n, 1))
    corners = [points - half * a, points - half * b, points + half * a, points + 0.8 * half * b]
    vertices = np.stack(corners, axis=1).reshape(-1, 3)
    k = 4 * np.arange(n)[:, None]
    faces = np.concatenate([k + np.array([0, 1, 2]), k + np.array([0, 2, 3])])
    return Mesh(vertices.astype(np.float32), faces.astype(np.int32))


def _in_lumps(rng: np.random.Generator, count: int, lumps: F64, radii: F64) -> F64:
    """Points (count, 3) near the surface of balls (L, 3) of radii (L,)."""
    which = rng.integers(len(lumps), size=count)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    depth = 1.0 - 0.6 * rng.random((count, 1)) ** 2
    points: F64 = lumps[which] + direction * depth * radii[which, None]
    return points


def tree(rng: np.random.Generator) -> Mesh:
    """A broad-leaved tree, a conifer or a bare one, on z = 0, metres."""
    height = rng.uniform(3.0, 14.0)
    trunk = rng.uniform(0.035, 0.05) * height**0.8
    style = rng.choice(['broad', 'conifer', 'bare', 'round'], p=[0.5, 0.2, 0.12, 0.18])
    lean = rng.normal(0.0, 0.04, 2) * height
    s = np.linspace(0.0, 1.0, 6)[:, None]
    wobble = np.cumsum(rng.normal(0.0, 0.02 * height, (6, 2)), axis=0) * s
    stem = np.concatenate([lean * s + wobble, 0.85 * height * s], axis=1)
    parts = [tube(stem, trunk * np.array([1.5, 1.0, 0.85, 0.65, 0.45, 0.2]), 9)]
    tips = []
    for _ in range(int(rng.integers(4, 9)) if style != 'conifer' else 0):
        k = int(rng.integers(2, 5))
        out = rng.normal(size=3) * [1.0, 1.0, 0.25] + [0.0, 0.0, 0.6]
        tip = stem[k] + out / np.linalg.norm(out) * rng.uniform(0.15, 0.35) * height
        bend = 0.5 * (stem[k] + tip) + [0.0, 0.0, -0.02 * height]
        parts.append(tube([stem[k], bend, tip], trunk * np.array([0.5, 0.35, 0.12]), 6))
        tips.append(tip)
    if style == 'conifer':
        z = np.sqrt(rng.random(500)) * 0.9
        wide = rng.uniform(0.14, 0.25) * height
        phi = rng.uniform(0.0, 2.0 * np.pi, 500)
        r = wide * z * (0.55 + 0.45 * rng.random(500))
        points = np.stack([r * np.cos(phi), r * np.sin(phi), height * (1.0 - z)], axis=1)
        parts.append(foliage(rng, points, 0.3))
    elif style != 'bare':
        top = stem[-1] if style == 'round' else 0.5 * (stem[-1] + stem[-2])
        lumps = np.array([top, *tips])
        radii = rng.uniform(0.1, 0.22, len(lumps)) * height
        parts.append(foliage(rng, _in_lumps(rng, 600, lumps, radii), 0.05 * height**0.5 + 0.16))
    return merge(parts)


def bush(rng: np.random.Generator) -> Mesh:
    """A bush of random shape on z = 0, metres."""
    size = rng.uniform(0.3, 1.1)
    count = int(rng.integers(2, 6))
    lumps = rng.normal(0.0, 0.6 * size, (count, 3))
    lumps[:, 2] = rng.uniform(0.4, 1.0, count) * size
    points = _in_lumps(rng, 220, lumps, rng.uniform(0.4, 0.8, count) * size)
    points[:, 2] = np.abs(points[:, 2])
    return foliage(rng, points, 0.22)


def hedge(rng: np.random.Generator, length_m: float) -> Mesh:
    """A clipped hedge along x from 0, metres."""
    deep, tall = rng.uniform(0.3, 0.9), rng.uniform(0.6, 2.2)
    count = int(np.clip(45 * length_m * tall, 60, 1400))
    points = rng.uniform([0.0, -0.5 * deep, 0.0], [length_m, 0.5 * deep, tall], (count, 3))
    skin = rng.random(count)
    points[skin < 0.35, 1] = -0.5 * deep
    points[(skin >= 0.35) & (skin < 0.7), 1] = 0.5 * deep
    points[skin > 0.85, 2] = tall
    return foliage(rng, points + rng.normal(0.0, 0.04, points.shape), 0.2)


def rock(rng: np.random.Generator) -> Mesh:
    """A rock or a heap of soil, half sunk in the ground, metres."""
    shape = blob(rng, float(rng.uniform(0.2, 1.0)), 0.3)
    return moved(shape, (0.0, 0.0, -0.05), scale=rng.uniform([0.7, 0.7, 0.4], [1.5, 1.2, 0.9]))


@dataclass(frozen=True, eq=False)
class Terrain:
    """Rough ground along a centre line.

    Attributes:
        centre: the centre line.
        profile: (K, 2) offset to the left and height of the cross-section, metres.
        rough: (K2, 2) offset to the left and strength of the small bumps.
        swell: long waves of the ground.
        bumps: short waves, scaled by `rough`.
    """

    centre: Track
    profile: F64
    rough: F64
    swell: SmoothNoise
    bumps: SmoothNoise

    def offset_m(self, xy: F64) -> F64:
        """Signed distance (N,) of points (N, 2) from the centre line, left positive."""
        line = self.centre.points
        result = np.empty(len(xy))
        for k in range(0, len(xy), 4096):
            part = xy[k : k + 4096]
            gap = part[:, None] - line[None]
            near = (gap**2).sum(-1).argmin(1)
            angle = self.centre.heading[near]
            d = gap[np.arange(len(part)), near]
            result[k : k + 4096] = -np.sin(angle) * d[:, 0] + np.cos(angle) * d[:, 1]
        return result

    def heights(self, xy: F64, offset_m: F64 | None = None) -> F64:
        """Heights (N,) at points (N, 2), metres."""
        d = self.offset_m(xy) if offset_m is None else offset_m
        z = np.interp(d, self.profile[:, 0], self.profile[:, 1]) + self.swell(xy)
        rough: F64 = z + np.interp(d, self.rough[:, 0], self.rough[:, 1]) * self.bumps(xy)
        return rough

    def height(self, x: float, y: float) -> float:
        """Height at one point, metres."""
        return float(self.heights(np.array([[x, y]]))[0])

    def at(self, s_m: float, d_m: float) -> tuple[F64, float]:
        """World point (3,) on the ground, and heading, at a place of the centre line."""
        place, heading = self.centre.at(s_m)
        x = place[0] - d_m * np.sin(heading)
        y = place[1] + d_m * np.cos(heading)
        return np.array([x, y, self.height(x, y)]), heading

    def mesh(self, step_m: float = 0.6, reach_m: float = 45.0) -> Mesh:
        """The ground as triangles, finer near the centre line and at the steps of the profile."""
        s = np.arange(0.0, self.centre.length_m + step_m, step_m)
        inner = np.arange(-9.0, 9.01, 0.5)
        outer = np.concatenate([np.arange(9.8, 20.0, 1.0), np.arange(20.5, reach_m, 2.5)])
        knots = self.profile[:, 0]
        near = knots[np.abs(knots) < reach_m]
        d = np.unique(np.round(np.concatenate([-outer, inner, outer, near]), 3))
        line = np.array([[*self.centre.at(v)[0], self.centre.at(v)[1]] for v in s])
        left = np.stack([-np.sin(line[:, 2]), np.cos(line[:, 2])], axis=1)
        xy = line[:, None, :2] + d[None, :, None] * left[:, None]
        flat = xy.reshape(-1, 2)
        z = self.heights(flat, np.broadcast_to(d, xy.shape[:2]).reshape(-1))
        return grid(np.concatenate([flat, z[:, None]], axis=1).reshape(*xy.shape[:2], 3))


def make_terrain(
    rng: np.random.Generator, centre: Track, profile: ArrayLike, *, wild: float = 1.0
) -> Terrain:
    """Rough ground of a cross-section (K, 2) along a centre line; `wild` scales the bumps."""
    section = np.asarray(profile, dtype=np.float64)
    edge = float(rng.uniform(5.0, 9.0))
    rough = np.array([[-edge - 4, 3.0], [-edge, 1.0], [edge, 1.0], [edge + 4, 3.0]])
    return Terrain(
        centre,
        section,
        rough * [1.0, wild],
        SmoothNoise(rng, (12.0, 70.0), float(rng.uniform(0.05, 0.35)) * wild, dim=2),
        SmoothNoise(rng, (0.9, 5.0), float(rng.uniform(0.012, 0.035)), waves=8, dim=2),
    )
