# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Point operations compiled by numba: Morton order, voxel barycentres, pairwise bins.

All run on one thread without the GIL and do not depend on the order of the input points.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled, compiled_fast

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    I32 = NDArray[np.int32]
    I64 = NDArray[np.int64]

_DIGITS = 2048


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
def radix_order(keys: I64) -> I64:
    """Stable ascending order (N,) of keys that are not negative; a pass per 11 bits in use."""
    n = keys.shape[0]
    order, other = np.arange(n), np.empty(n, np.int64)
    places = np.empty(_DIGITS + 1, np.int64)
    most = keys.max() if n else 0
    shift = 0
    while most >> shift:
        places[:] = 0
        for i in range(n):
            places[((keys[i] >> shift) & (_DIGITS - 1)) + 1] += 1
        for d in range(_DIGITS):
            places[d + 1] += places[d]
        for i in range(n):
            k = order[i]
            digit = (keys[k] >> shift) & (_DIGITS - 1)
            other[places[digit]] = k
            places[digit] += 1
        order, other = other, order
        shift += 11
    return order


@compiled
def nearest_others(points: F32, count: int) -> I32:
    """The `count` nearest other points of each of (S, 3), nearest first, padded with S."""
    s = points.shape[0]
    near = np.full((s, count), s, np.int32)
    squared, best = np.empty(s, np.float32), np.empty(count, np.float32)
    for n in range(s):
        for m in range(s):
            x = points[n, 0] - points[m, 0]
            y = points[n, 1] - points[m, 1]
            z = points[n, 2] - points[m, 2]
            squared[m] = x * x + y * y + z * z
        squared[n] = np.inf
        best[:] = np.inf
        for m in range(s):
            if squared[m] >= best[count - 1]:
                continue
            k = count - 1
            while k > 0 and best[k - 1] > squared[m]:
                best[k], near[n, k] = best[k - 1], near[n, k - 1]
                k -= 1
            best[k], near[n, k] = squared[m], m
    return near


@compiled_fast
def _angle_bins(
    u: tuple[float, float, float], x: F32, y: F32, z: F32, per_radian: float, first: int, out: I32
) -> None:
    """`first` plus the bin of the angle between a vector and each of (S,) others, into `out`.

    The arc tangent is a polynomial (Abramowitz and Stegun 4.4.49, error 2e-8), for arithmetic
    without branches runs in vector registers.
    """
    ux, uy, uz = np.float32(u[0]), np.float32(u[1]), np.float32(u[2])
    rate, half, least = np.float32(per_radian), np.float32(0.5), np.float32(1e-30)
    quarter, straight = np.float32(0.5 * np.pi), np.float32(np.pi)
    for m in range(x.shape[0]):
        cx, cy, cz = uy * z[m] - uz * y[m], uz * x[m] - ux * z[m], ux * y[m] - uy * x[m]
        s = np.sqrt(cx * cx + cy * cy + cz * cz)
        c = ux * x[m] + uy * y[m] + uz * z[m]
        a = abs(c)
        t = min(s, a) / max(s, a, least)
        q = t * t
        p = np.float32(-0.0161657367) + q * np.float32(0.0028662257)
        p = np.float32(0.0429096138) + q * p
        p = np.float32(-0.0752896400) + q * p
        p = np.float32(0.1065626393) + q * p
        p = np.float32(-0.1420889944) + q * p
        p = np.float32(0.1999355085) + q * p
        p = np.float32(-0.3333314528) + q * p
        angle = t + t * q * p
        angle = quarter - angle if s > a else angle
        angle = straight - angle if c < np.float32(0.0) else angle
        out[m] = first + np.int32(angle * rate + half)


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
    x, y, z = np.empty(s, np.float32), np.empty(s, np.float32), np.empty(s, np.float32)
    row = np.empty(s, np.int32)
    for n in range(s):
        for m in range(s):
            x[m] = points[m, 0] - points[n, 0]
            y[m] = points[m, 1] - points[n, 1]
            z[m] = points[m, 2] - points[n, 2]
            d = np.sqrt(x[m] * x[m] + y[m] * y[m] + z[m] * z[m])
            bins[n, m, 0] = min(int(d / distance_step + 0.5), distance_bins - 1)
        for k in range(a):
            j = neighbours[n, k]
            if j >= s:
                bins[n, :, 1 + k] = distance_bins
                continue
            _angle_bins((x[j], y[j], z[j]), x, y, z, per_radian, distance_bins, row)
            for m in range(s):
                bins[n, m, 1 + k] = row[m]
            bins[n, n, 1 + k] = distance_bins
    return bins
