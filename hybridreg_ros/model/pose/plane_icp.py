# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A fast point-to-plane alignment on a grid, to bring many rough poses to where they belong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.core.se3 import rotation_of
from hybridreg_ros.model.geometry.grid import cell_point, moved

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.model.geometry.grid import Grid, Space
    from hybridreg_ros.model.geometry.views import View

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    I32 = NDArray[np.int32]
    Triple = tuple[float, float, float]
    Sums = tuple[float, ...]

_DAMPING = 1e-3
_MIN_HITS = 10.0
_SMALL = 1e-3
_NOTHING = (0.0,) * 28
"""Sums over the point-to-plane equations of a step: the upper triangle of the 6x6 matrix row by
row, the right side, the weights. As a tuple they stay in registers, which an array would not."""


@compiled
def _contacts(T: F64, sample: F32, points: F32, space: Space, r2: float) -> tuple[I32, F32]:
    index = np.full(sample.shape[0], -1, np.int32)
    squared = np.full(sample.shape[0], r2, np.float32)
    for i in range(sample.shape[0]):
        x, y, z = moved(T, sample[i, 0], sample[i, 1], sample[i, 2])
        j = cell_point(x, y, z, space)
        if j >= 0:
            d2 = (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2 + (points[j, 2] - z) ** 2
            if d2 < r2:
                index[i], squared[i] = j, d2
    return index, squared


def contacts(T: F64, sample: F32, fixed: View, radius: float) -> tuple[I32, F32]:
    """The point of a fixed cloud that each moved point meets.

    Args:
        T: (4, 4) voxels.
        sample: (N, 3) float32, voxels.
        fixed: the other cloud.
        radius: farther points meet nothing, voxels.

    Returns:
        (N,) int32 point of the fixed cloud, -1 for none, and (N,) float32 squared distance,
        radius^2 for none.
    """
    found: tuple[I32, F32] = _contacts(T, sample, fixed.points, fixed.grid.space, radius**2)
    return found


@compiled
def _normal_equations(
    T: F64, sample: F32, points: F32, normals: F32, space: Space, r2: float
) -> Sums:
    """Sums of one step (rotation about the origin first)."""
    sums = _NOTHING
    for i in range(sample.shape[0]):
        x, y, z = moved(T, sample[i, 0], sample[i, 1], sample[i, 2])
        j = cell_point(x, y, z, space)
        if j >= 0:
            gap = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
            normal = normals[j, 0], normals[j, 1], normals[j, 2]
            sums = _added(sums, (x, y, z), gap, normal, r2)
    return sums


@compiled
def _reverse_equations(
    T: F64, sample: F32, points: F32, normals: F32, space: Space, r2: float, sums: Sums
) -> Sums:
    """The same for points of the target (`sample`) and the moving surface, added to `sums`."""
    for i in range(sample.shape[0]):
        u, v, w = sample[i, 0] - T[0, 3], sample[i, 1] - T[1, 3], sample[i, 2] - T[2, 3]
        j = cell_point(
            T[0, 0] * u + T[1, 0] * v + T[2, 0] * w,
            T[0, 1] * u + T[1, 1] * v + T[2, 1] * w,
            T[0, 2] * u + T[1, 2] * v + T[2, 2] * w,
            space,
        )
        if j < 0:
            continue
        x, y, z = moved(T, points[j, 0], points[j, 1], points[j, 2])
        u, v, w = normals[j, 0], normals[j, 1], normals[j, 2]
        normal = (
            T[0, 0] * u + T[0, 1] * v + T[0, 2] * w,
            T[1, 0] * u + T[1, 1] * v + T[1, 2] * w,
            T[2, 0] * u + T[2, 1] * v + T[2, 2] * w,
        )
        gap = sample[i, 0] - x, sample[i, 1] - y, sample[i, 2] - z
        sums = _added(sums, (x, y, z), gap, normal, r2)
    return sums


@compiled
def _added(s: Sums, moved: Triple, gap: Triple, normal: Triple, r2: float) -> Sums:
    """Sums with one point-to-plane equation more, weighted down towards the radius."""
    dx, dy, dz = gap
    d2 = dx * dx + dy * dy + dz * dz
    if d2 >= r2:
        return s
    x, y, z = moved
    f, g, h = normal
    c, d, e = y * h - z * g, z * f - x * h, x * g - y * f
    weight = (1.0 - d2 / r2) ** 2
    t, u, v = weight * c, weight * d, weight * e
    p, q, r = weight * f, weight * g, weight * h
    along = dx * f + dy * g + dz * h
    return (
        s[0] + t * c, s[1] + t * d, s[2] + t * e, s[3] + t * f, s[4] + t * g, s[5] + t * h,
        s[6] + u * d, s[7] + u * e, s[8] + u * f, s[9] + u * g, s[10] + u * h,
        s[11] + v * e, s[12] + v * f, s[13] + v * g, s[14] + v * h,
        s[15] + p * f, s[16] + p * g, s[17] + p * h,
        s[18] + q * g, s[19] + q * h,
        s[20] + r * h,
        s[21] + t * along, s[22] + u * along, s[23] + v * along,
        s[24] + p * along, s[25] + q * along, s[26] + r * along,
        s[27] + weight,
    )  # fmt: skip


@compiled
def _step(T: F64, xi: F64) -> F64:
    """A transform (4, 4) followed by a rotation vector and a translation (6,)."""
    R, out = rotation_of(xi[:3]), T.copy()
    for i in range(3):
        for j in range(4):
            out[i, j] = R[i, 0] * T[0, j] + R[i, 1] * T[1, j] + R[i, 2] * T[2, j]
        out[i, 3] += xi[3 + i]
    return out


@compiled
def _solved(T: F64, sums: Sums) -> tuple[F64, bool]:
    """The pose after a damped Gauss-Newton step, and whether it hardly moved."""
    A, b, k = np.empty((6, 6)), np.empty(6), 0
    for i in range(6):
        for j in range(i, 6):
            A[i, j] = A[j, i] = sums[k]
            k += 1
        b[i] = sums[21 + i]
    for i in range(6):
        A[i, i] += _DAMPING * A[i, i] + 1e-6 * sums[27]
    xi = np.linalg.solve(A, b)
    done = np.abs(xi[:3]).max() < _SMALL * 0.2 and np.abs(xi[3:]).max() < 10.0 * _SMALL
    return _step(T, xi), done


@compiled
def _align(
    T: F64,
    sample: F32,
    points: F32,
    normals: F32,
    space: Space,
    radius: float,
    rounds: int,
) -> F64:
    """Some Gauss-Newton rounds from one pose; `space` is a grid, its corner and its cell."""
    for _ in range(rounds):
        sums = _normal_equations(T, sample, points, normals, space, radius * radius)
        if sums[27] < _MIN_HITS:
            break
        T, done = _solved(T, sums)
        if done:
            break
    return T


def aligned_both_ways(
    T: F64, source: View, target: View, stages: Sequence[tuple[str, float, int]]
) -> F64:
    """A pose (4, 4) after rounds in which each cloud's sample is drawn to the other's surface.

    Swapping the clouds gives the inverse.

    Args:
        T: pose, voxels.
        source: its surface is moved.
        target: its surface is fixed.
        stages: name of the views' grid, radius beyond which points are ignored, most rounds.
    """
    for name, radius, rounds in stages:
        there, back = (getattr(view, name).space for view in (target, source))
        for _ in range(rounds):
            sums = _normal_equations(
                T, source.sample, target.points, target.normals, there, radius * radius
            )
            sums = _reverse_equations(
                T, target.sample, source.points, source.normals, back, radius * radius, sums
            )
            if sums[27] < _MIN_HITS:
                break
            T, done = _solved(T, sums)
            if done:
                break
    return T


def plane_icp(
    T: F64, source: View, target: View, stages: Sequence[tuple[Grid, float, int]]
) -> F64:
    """Each of B poses (B, 4, 4) after an alignment of the source's sample.

    Args:
        T: poses, voxels.
        source: its sample is moved.
        target: its points and normals are fixed.
        stages: grid of the target, radius beyond which points are ignored, and most rounds.
    """
    out = np.ascontiguousarray(T).copy()
    for b in range(len(out)):
        for grid, radius, rounds in stages:
            out[b] = _align(
                out[b],
                source.sample,
                target.points,
                target.normals,
                grid.space,
                radius,
                rounds,
            )
    return out
