# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Cells of one scan that grow with the range as the rays part, and what hangs together in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.jit import compiled
from hybridreg_ros.odometry.dynamics import segments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

_SPAN = 2048
"""So many cells from the sensor to each side: with rays 0.4 deg apart, far beyond any range."""
_RAYS = 2.0
"""Edge of a far cell, in distances between neighbouring rays."""
LARGER = {'depth': 1.0, 'lidar': 1.4}
"""Edge of the cells of the mask, in voxels (docs/lab/2026-11-29-mask-at-its-floors.md)."""


@dataclass(frozen=True, eq=False)
class Grid:
    """How large cells are: one edge near the sensor, from some range on a share of the range.

    Attributes:
        near_m: edge of a cell near the sensor.
        slope: edge of a cell far away, as a share of the range.
    """

    near_m: float
    slope: float

    @classmethod
    def of(cls, near_m: float, step_rad: F64, larger: float = 1.0) -> Grid:
        """The grid of a sensor whose rays are (2,) so far apart."""
        return cls(larger * near_m, larger * _RAYS * float(step_rad.max()))

    def warped(self, points: NDArray[np.floating]) -> F64:
        """Points (N, 3), sensor frame, moved along their rays so that every cell is a unit cube.

        With the edge c(r) of a cell at range r, a point goes to the range of the integral of 1/c.
        """
        out = np.empty(points.shape)
        _warp(points, self.near_m, self.slope, out)
        return out


class Columns(NamedTuple):
    """Cells in the order of their place: those of one column, then the next column.

    Attributes:
        first: (A * B + 1,) int32 first cell of each column, in a box with two empty ones around.
        low: (2,) place of the first column.
        width: B, columns along the second axis.
        column: (M,) int32 column of each cell.
        height: (M,) int32 its place along the third axis.
    """

    first: NDArray[np.int32]
    low: NDArray[np.int64]
    width: int
    column: NDArray[np.int32]
    height: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Cells:
    """The occupied cells of one scan.

    Attributes:
        grid: how large they are.
        T_odom_sensor: (4, 4) pose of the scan.
        columns: where they are.
        pairs: (2, K) int32 cells that touch, the lower one first (`segments.neighbours`).
        of_point: (N,) int32 cell of each point that the cells were made of, -1 = none.
        counts: (M,) measured points per cell.
        size_m: (M,) edge of each cell.
        centre: (M, 3) mean point, sensor frame, metres.
        range_m: (M,) its range.
        normal: (M, 3) unit, towards the sensor, sensor axes.
        flat: (M,) bool, whether the normal means anything.
    """

    grid: Grid
    T_odom_sensor: F64
    columns: Columns
    pairs: NDArray[np.int32]
    of_point: NDArray[np.int32]
    counts: NDArray[Any]
    size_m: F64
    centre: F64
    range_m: F64
    normal: F64
    flat: NDArray[np.bool_]

    @classmethod
    def of(
        cls, points: NDArray[np.float32], counts: NDArray[np.int32], T_odom_sensor: F64, grid: Grid
    ) -> Cells:
        """Cells of thinned points (N, 3), sensor frame, each the mean of so many (N,)."""
        *columns, cell = _sorted(grid.warped(points))
        columns = Columns(*columns)
        pairs = segments.neighbours(*columns)
        total, centre, ranges, normal, flat = segments.normals(points, counts, cell, pairs)
        size = np.maximum(grid.near_m, grid.slope * ranges)
        surface = total, size, centre, ranges, normal, flat
        return cls(grid, T_odom_sensor, columns, pairs, cell, *surface)

    def __len__(self) -> int:
        """Number of cells."""
        return len(self.counts)

    @cached_property
    def parts(self) -> tuple[NDArray[np.int32], int]:
        """Large smooth surfaces, and what is left divided where surfaces fold inwards.

        Returns:
            Part (M,) of each cell, and number of parts.
        """
        surface, count = self._divided(self.flat, by_surface=True)
        # The last entry is of the cells of no surface, which are number -1.
        is_large = np.bincount(surface + 1, minlength=count + 1)[1:] >= segments.LARGE
        is_large = np.append(is_large, np.False_)
        large = is_large[surface]
        part, things = self._divided(~large, by_surface=False)
        number = things - 1 + np.cumsum(is_large)
        part[large] = number[surface[large]]
        return part, things + int(is_large.sum())

    def _divided(
        self, member: NDArray[np.bool_], *, by_surface: bool
    ) -> tuple[NDArray[np.int32], int]:
        surface = self.centre, self.normal, self.flat, self.size_m
        part, count = segments.divide(self.pairs, member, *surface, by_surface)
        return part, int(count)

    def at(
        self, points: NDArray[np.floating], T_odom_sensor: F64, values: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Values (M, V) of these cells at points (N, 3) of a scan at another pose.

        Returns:
            (N, V + 1): the values of the cell there, or the mean of those around an empty one; the
            last column is 1, or 0.5 for such a mean, or 0 where there is nothing.
        """
        there = se3.apply(se3.inverse(self.T_odom_sensor) @ T_odom_sensor, points)
        out = np.zeros((len(points), values.shape[1] + 1), np.float32)
        _values_at(self.grid.warped(there), self.columns, values, out)
        return out


@compiled
def _warp(points, near, slope, out):  # type: ignore[no-untyped-def]
    turn = near / slope
    for row in range(len(points)):
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        r = np.sqrt(x * x + y * y + z * z)
        share = 1.0 / near
        if r > turn:
            share = turn / near * (1.0 + np.log(r / turn)) / r
        out[row, 0], out[row, 1], out[row, 2] = x * share, y * share, z * share


@compiled
def _sorted(warped):  # type: ignore[no-untyped-def]
    """Cells of warped points (N, 3): the fields of `Columns`, and the cell of each point."""
    n = len(warped)
    place, column = np.empty((n, 3), np.int32), np.full(n, -1, np.int32)
    low, high = np.full(2, _SPAN), np.full(2, -_SPAN)
    for row in range(n):
        x, y, z = warped[row, 0], warped[row, 1], warped[row, 2]
        if abs(x) < _SPAN and abs(y) < _SPAN and abs(z) < _SPAN:  # and not NaN
            column[row] = 0
            i, j = np.int32(np.floor(x)), np.int32(np.floor(y))
            place[row, 0], place[row, 1], place[row, 2] = i, j, np.int32(np.floor(z))
            low[0], high[0] = min(low[0], i), max(high[0], i)
            low[1], high[1] = min(low[1], j), max(high[1], j)
    low, width = low - 2, max(0, high[1] - low[1]) + 5
    first = np.zeros(max(0, high[0] - low[0] + 3) * width + 1, np.int32)
    for row in range(n):
        if column[row] >= 0:
            column[row] = (place[row, 0] - low[0]) * width + place[row, 1] - low[1]
            first[column[row] + 1] += 1
    for c in range(1, len(first)):
        first[c] += first[c - 1]
    rows = np.empty(first[-1], np.int32)  # by column
    for row in range(n):
        c = column[row]
        if c >= 0:
            rows[first[c]] = row  # `first` comes to be the end of each
            first[c] += 1
    return _stacked(rows, place[:, 2], first, low, width, column)


@compiled
def _stacked(rows, height, first, low, width, cell):  # type: ignore[no-untyped-def]
    """The cells of each column, upwards; `first` and `cell` are written over."""
    heights, columns = np.empty(len(rows), np.int32), np.empty(len(rows), np.int32)
    count, begin = 0, 0
    for c in range(len(first) - 1):
        start, end, first[c] = count, first[c], count
        for row in rows[begin:end]:
            q = count
            while q > start and heights[q - 1] > height[row]:
                q -= 1
            if q == start or heights[q - 1] < height[row]:
                for above in range(count, q, -1):
                    heights[above] = heights[above - 1]
                heights[q], columns[count] = height[row], c
                count += 1
        for row in rows[begin:end]:
            cell[row] = start
            while heights[cell[row]] < height[row]:
                cell[row] += 1
        begin = end
    first[-1] = count
    return first, low, width, columns[:count].copy(), heights[:count].copy(), cell


@compiled
def _values_at(warped, cells, values, out):  # type: ignore[no-untyped-def]
    """The kernel of `Cells.at`."""
    last, width = values.shape[1], cells.width
    for row in range(len(warped)):
        i = int(np.floor(warped[row, 0])) - cells.low[0]
        j = int(np.floor(warped[row, 1])) - cells.low[1]
        k = int(np.floor(warped[row, 2]))
        c = i * width + j
        if i < 1 or j < 1 or j >= width - 1 or c + width + 2 > len(cells.first):
            continue
        for q in range(cells.first[c], cells.first[c + 1]):
            if cells.height[q] == k:
                out[row, :last] = values[q]
                out[row, last] = 1.0
        if out[row, last]:
            continue
        found = 0
        for line in (c - width, c, c + width):
            for q in range(cells.first[line - 1], cells.first[line + 2]):
                if abs(cells.height[q] - k) <= 1:
                    for column in range(last):
                        out[row, column] += values[q, column]
                    found += 1
        if found:
            for column in range(last):
                out[row, column] /= found
            out[row, last] = 0.5
