# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fixed-radius search of nearest neighbours on a hashed grid of cells, compiled by numba."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.model.geometry.ops import bounds

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    I32 = NDArray[np.int32]
    I64 = NDArray[np.int64]


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
def _cell_of(queries: F32, low: NDArray[np.float64], inverse_cell: float, reach: int) -> I32:
    """(Q, 3) int32 cell of each query; those far outside are moved to where nothing is."""
    cells = np.empty((queries.shape[0], 3), np.int32)
    for q in range(queries.shape[0]):
        for k in range(3):
            at = np.floor((float(queries[q, k]) - low[k]) * inverse_cell)
            cells[q, k] = int(min(max(at, -1.0 - reach), 2.0**20))
    return cells


@compiled
def _gather_cells(
    at: I32, reach: int, cells: tuple[I64, I64, I64, I64, F32], near: F32, index: I64
) -> int:
    """Coordinates (3, m) and numbers (m,) of the points in the cells around one; returns m."""
    order, table_key, table_start, table_stop, placed = cells
    mask = table_key.shape[0] - 1
    m = 0
    for z in range(max(at[2] - reach, 0) + 1, at[2] + reach + 2):
        for y in range(max(at[1] - reach, 0) + 1, at[1] + reach + 2):
            for x in range(max(at[0] - reach, 0) + 1, at[0] + reach + 2):
                key = x | (y << 21) | (z << 42)
                slot = _slot(key, mask)
                while table_key[slot] != key and table_key[slot] != -1:
                    slot = (slot + 1) & mask
                if table_key[slot] == -1:
                    continue
                for k in range(table_start[slot], table_stop[slot]):
                    near[0, m], near[1, m], near[2, m] = placed[k, 0], placed[k, 1], placed[k, 2]
                    index[m] = order[k]
                    m += 1
    return m


@compiled
def _smallest(keys: I64, count: int, best: I64, limit: int) -> int:
    """Put the `limit` smallest of the first `count` keys into `best`, sorted; returns how many."""
    kept = 0
    for c in range(count):
        key = keys[c]
        if kept == limit:
            if key >= best[limit - 1]:
                continue
            kept -= 1
        p = kept
        while p > 0 and best[p - 1] > key:
            best[p] = best[p - 1]
            p -= 1
        best[p] = key
        kept += 1
    return kept


@compiled
def _search(
    queries: F32,
    cells: tuple[I64, I64, I64, I64, F32],
    low: NDArray[np.float64],
    inverse_cell: float,
    radius: float,
    limit: int,
) -> I32:
    """Nearest `limit` points within the radius of each query, nearest first, ties by index.

    Queries of one cell share the points around it. A squared distance and its point are sorted
    as one integer: the bits of a float that is not negative are in the order of its value.
    """
    n, count = cells[4].shape[0], queries.shape[0]
    reach = int(np.ceil(radius * inverse_cell))
    at = _cell_of(queries, low, inverse_cell, reach)
    key = np.empty(count, np.int64)
    for q in range(count):
        key[q] = (at[q, 0] + reach + 1) | (
            ((at[q, 1] + reach + 1) | ((at[q, 2] + reach + 1) << 21)) << 21
        )
    visit = np.argsort(key)
    found = np.full((count, limit), n, np.int32)
    near, index = np.empty((3, n), np.float32), np.empty(n, np.int64)
    squared, inside = np.empty(n, np.float32), np.empty(n + 1, np.int64)
    best = np.empty(limit, np.int64)
    bits = squared.view(np.int32)
    r2 = np.float32(radius * radius)
    m = 0
    for v in range(count):
        q = visit[v]
        if v == 0 or key[q] != key[visit[v - 1]]:
            m = _gather_cells(at[q], reach, cells, near, index)
        qx, qy, qz = queries[q, 0], queries[q, 1], queries[q, 2]
        for c in range(m):
            dx, dy, dz = near[0, c] - qx, near[1, c] - qy, near[2, c] - qz
            squared[c] = dx * dx + dy * dy + dz * dz
        entries = 0
        for c in range(m):  # written always, counted only when inside: no branch to guess
            inside[entries] = (np.int64(bits[c]) << 32) | index[c]
            entries += 1 if squared[c] <= r2 else 0
        for p in range(_smallest(inside, entries, best, limit)):
            found[q, p] = best[p] & 0xFFFFFFFF
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
        low, _ = bounds(points)
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
