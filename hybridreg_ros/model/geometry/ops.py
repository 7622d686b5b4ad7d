# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Point operations compiled by numba: Morton order, voxel barycentres, pairwise bins.

All run on one thread without the GIL and do not depend on the order of the input points.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    I32 = NDArray[np.int32]
    I64 = NDArray[np.int64]

MORTON_BITS = 21


@compiled
def _spread_bits(v: int) -> int:
    """Put two zero bits between the 21 low bits of v."""
    v &= 0x1FFFFF
    v = (v | (v << 32)) & 0x1F00000000FFFF
    v = (v | (v << 16)) & 0x1F0000FF0000FF
    v = (v | (v << 8)) & 0x100F00F00F00F00F
    v = (v | (v << 4)) & 0x10C30C30C30C30C3
    return (v | (v << 2)) & 0x1249249249249249


@compiled
def morton_keys(points: F32, inverse_size: float, shift: NDArray[np.float64]) -> I64:
    """Morton key of the voxel of each point.

    Args:
        points: (N, 3) float32.
        inverse_size: one over the voxel size.
        shift: (3,) float64, first voxel of the grid along each axis.

    Returns:
        (N,) int64; key >> 3 is the key of the voxel of twice the size.
    """
    n = points.shape[0]
    keys = np.empty(n, np.int64)
    for i in range(n):
        x = int(np.floor(float(points[i, 0]) * inverse_size) - shift[0])
        y = int(np.floor(float(points[i, 1]) * inverse_size) - shift[1])
        z = int(np.floor(float(points[i, 2]) * inverse_size) - shift[2])
        keys[i] = _spread_bits(x) | (_spread_bits(y) << 1) | (_spread_bits(z) << 2)
    return keys


@compiled
def finite_rows(points: F32) -> NDArray[np.bool_]:
    """Which points (N, 3) have no NaN or inf, (N,)."""
    finite = np.empty(points.shape[0], np.bool_)
    for i in range(points.shape[0]):
        finite[i] = (
            np.isfinite(points[i, 0]) and np.isfinite(points[i, 1]) and np.isfinite(points[i, 2])
        )
    return finite


@compiled
def bounds(points: F32) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Smallest and largest coordinate along each axis, (3,) each, of points (N, 3) without NaN."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(points.shape[0]):
        for k in range(3):
            low[k] = min(low[k], points[i, k])
            high[k] = max(high[k], points[i, k])
    return low, high


@compiled
def runs_of(sorted_keys: I64) -> I64:
    """First index of every run of equal keys, and the length of the array at the end."""
    n = sorted_keys.shape[0]
    count = 0
    for i in range(n):
        if i == 0 or sorted_keys[i] != sorted_keys[i - 1]:
            count += 1
    starts = np.empty(count + 1, np.int64)
    count = 0
    for i in range(n):
        if i == 0 or sorted_keys[i] != sorted_keys[i - 1]:
            starts[count] = i
            count += 1
    starts[count] = n
    return starts


@compiled
def barycentres(
    points: F32, order: I64, starts: I64, scale: float, shift: NDArray[np.float64]
) -> F32:
    """Mean of the points of every run, in voxels: (R, 3) float32 of `points * scale - shift`."""
    runs = starts.shape[0] - 1
    means = np.empty((runs, 3), np.float32)
    for r in range(runs):
        x = y = z = 0.0
        for k in range(starts[r], starts[r + 1]):
            i = order[k]
            x += float(points[i, 0])
            y += float(points[i, 1])
            z += float(points[i, 2])
        share = scale / (starts[r + 1] - starts[r])
        means[r, 0] = x * share - shift[0]
        means[r, 1] = y * share - shift[1]
        means[r, 2] = z * share - shift[2]
    return means


@compiled
def run_of_each(order: I64, starts: I64) -> I32:
    """(N,) int32 number of the run that each point is in."""
    owner = np.empty(order.shape[0], np.int32)
    for r in range(starts.shape[0] - 1):
        for k in range(starts[r], starts[r + 1]):
            owner[order[k]] = r
    return owner


@compiled
def geometry_bins(
    points: F32, neighbours: I32, distance_step: float, distance_bins: int, angle_bins: int
) -> NDArray[np.int16]:
    """Rows of the embedding table for every pair of points.

    Args:
        points: (S, 3) float32.
        neighbours: (S, A) int32 nearest other points of each, padded with S.
        distance_step: length per distance bin.
        distance_bins: number of distance bins; longer distances fall into the last.
        angle_bins: number of angle bins over [0, pi].

    Returns:
        (S, S, 1 + A) int16: distance bin of (n, m); then, for neighbour a of n, distance_bins plus
        the bin of the angle at n between that neighbour and m (0 where there is none).
    """
    s, a = neighbours.shape
    bins = np.empty((s, s, 1 + a), np.int16)
    per_radian = (angle_bins - 1) / np.pi
    for n in range(s):
        for m in range(s):
            vx = points[m, 0] - points[n, 0]
            vy = points[m, 1] - points[n, 1]
            vz = points[m, 2] - points[n, 2]
            d = np.sqrt(vx * vx + vy * vy + vz * vz)
            bins[n, m, 0] = min(int(d / distance_step + 0.5), distance_bins - 1)
            for k in range(a):
                bins[n, m, 1 + k] = distance_bins
                j = neighbours[n, k]
                if j >= s or m == n:
                    continue
                ux = points[j, 0] - points[n, 0]
                uy = points[j, 1] - points[n, 1]
                uz = points[j, 2] - points[n, 2]
                cx, cy, cz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
                angle = np.arctan2(
                    np.sqrt(cx * cx + cy * cy + cz * cz), ux * vx + uy * vy + uz * vz
                )
                bins[n, m, 1 + k] = distance_bins + int(angle * per_radian + 0.5)
    return bins
