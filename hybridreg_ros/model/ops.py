# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Point operations compiled by numba: Morton order, voxel barycentres, radius search, bins.

All run on one thread without the GIL and do not depend on the order of the input points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    I32 = NDArray[np.int32]
    I64 = NDArray[np.int64]

MORTON_BITS = 21


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Numba with an on-disk cache and without the GIL."""
    wrapped: Callable[..., Any] = numba.njit(cache=True, nogil=True, error_model='numpy')(function)
    return wrapped


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
def _slot(key: int, mask: int) -> int:
    """First place to look for a key in an open hash table of mask + 1 places."""
    h = (key ^ (key >> 31)) * 0x9E3779B97F4A7C1
    return (h ^ (h >> 29)) & mask


@compiled
def _build_cells(
    points: F32, low: NDArray[np.float64], inverse_cell: float
) -> tuple[I64, I64, I64, I64, F32]:
    """Hash table from cell key to a run of the points sorted by cell."""
    n = points.shape[0]
    keys = np.empty(n, np.int64)
    for i in range(n):
        x = int((float(points[i, 0]) - low[0]) * inverse_cell) + 1
        y = int((float(points[i, 1]) - low[1]) * inverse_cell) + 1
        z = int((float(points[i, 2]) - low[2]) * inverse_cell) + 1
        keys[i] = x | (y << 21) | (z << 42)
    order = np.argsort(keys, kind='mergesort')
    size = 16
    while size < 2 * n:
        size *= 2
    table_key = np.full(size, -1, np.int64)
    table_start = np.zeros(size, np.int64)
    table_stop = np.zeros(size, np.int64)
    placed = np.empty((n, 3), np.float32)
    begin = 0
    for k in range(n):
        placed[k] = points[order[k]]
        key = keys[order[k]]
        if k == n - 1 or keys[order[k + 1]] != key:
            slot = _slot(key, size - 1)
            while table_key[slot] != -1:
                slot = (slot + 1) & (size - 1)
            table_key[slot] = key
            table_start[slot] = begin
            table_stop[slot] = k + 1
            begin = k + 1
    return order, table_key, table_start, table_stop, placed


@compiled
def _search(
    queries: F32,
    cells: tuple[I64, I64, I64, I64, F32],
    low: NDArray[np.float64],
    inverse_cell: float,
    radius: float,
    limit: int,
) -> I32:
    """Nearest `limit` points within the radius of each query, nearest first, ties by index."""
    order, table_key, table_start, table_stop, placed = cells
    n, mask = placed.shape[0], table_key.shape[0] - 1
    found = np.full((queries.shape[0], limit), n, np.int32)
    distance = np.empty(limit, np.float32)
    r2 = np.float32(radius * radius)
    for q in range(queries.shape[0]):
        qx, qy, qz = queries[q, 0], queries[q, 1], queries[q, 2]
        count = 0
        x0 = max(int(np.floor((qx - radius - low[0]) * inverse_cell)), -1) + 1
        y0 = max(int(np.floor((qy - radius - low[1]) * inverse_cell)), -1) + 1
        z0 = max(int(np.floor((qz - radius - low[2]) * inverse_cell)), -1) + 1
        x1 = int(np.floor((qx + radius - low[0]) * inverse_cell)) + 1
        y1 = int(np.floor((qy + radius - low[1]) * inverse_cell)) + 1
        z1 = int(np.floor((qz + radius - low[2]) * inverse_cell)) + 1
        for z in range(z0, z1 + 1):
            for y in range(y0, y1 + 1):
                for x in range(x0, x1 + 1):
                    key = x | (y << 21) | (z << 42)
                    slot = _slot(key, mask)
                    while table_key[slot] != key and table_key[slot] != -1:
                        slot = (slot + 1) & mask
                    if table_key[slot] == -1:
                        continue
                    for k in range(table_start[slot], table_stop[slot]):
                        dx, dy, dz = placed[k, 0] - qx, placed[k, 1] - qy, placed[k, 2] - qz
                        d = dx * dx + dy * dy + dz * dz
                        if d > r2:
                            continue
                        i = order[k]
                        if count == limit:
                            last = distance[limit - 1]
                            if d > last or (d == last and i > found[q, limit - 1]):
                                continue
                            count -= 1
                        p = count
                        while p > 0 and (
                            distance[p - 1] > d or (distance[p - 1] == d and found[q, p - 1] > i)
                        ):
                            distance[p] = distance[p - 1]
                            found[q, p] = found[q, p - 1]
                            p -= 1
                        distance[p] = d
                        found[q, p] = i
                        count += 1
    return found


@dataclass(frozen=True, eq=False)
class CellList:
    """Points sorted into cubic cells, for fixed-radius searches.

    Attributes:
        cells: hash table and sorted points, as the compiled search reads them.
        low: (3,) float64 corner of the first cell.
        inverse_cell: one over the side of a cell.
    """

    cells: tuple[I64, I64, I64, I64, F32]
    low: NDArray[np.float64]
    inverse_cell: float

    @classmethod
    def build(cls, points: F32, cell: float) -> CellList:
        """Sort points (N, 3) into cells of side `cell`; a search is fastest with radius = cell."""
        low = points.min(axis=0).astype(np.float64)
        inverse = 1.0 / cell
        return cls(_build_cells(points, low, inverse), low, inverse)

    def search(self, queries: F32, radius: float, limit: int) -> I32:
        """Neighbours of each query.

        Returns:
            (Q, limit) int32 nearest points within the radius, nearest first (ties: lower index
            first), padded with the number of points.
        """
        found: I32 = _search(queries, self.cells, self.low, self.inverse_cell, radius, limit)
        return found


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
