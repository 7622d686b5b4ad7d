# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Cells of one scan that grow with the range as the rays part, and what hangs together in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.jit import compiled
from hybridreg_ros.odometry.dynamics import segments
from hybridreg_ros.odometry.map.thinning import occupied
from hybridreg_ros.odometry.map.voxel_hash import EMPTY, find_slot, voxel_key

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

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


@dataclass(frozen=True, eq=False)
class Cells:
    """The occupied cells of one scan.

    Attributes:
        grid: how large they are.
        T_odom_sensor: (4, 4) pose of the scan.
        table: (C,) int64 hash table of cell keys.
        slots: (C,) int32, cell of each table entry.
        start: (M + 1,) int32, with `other` the cells around each (`segments.neighbours`).
        other: (K,) int32.
        of_point: (N,) int32 cell of each point that the cells were made of, -1 = none.
        counts: (M,) measured points per cell.
        size_m: (M,) edge of each cell.
        centre: (M, 3) mean point, sensor frame, metres.
        normal: (M, 3) unit, towards the sensor, sensor axes.
        flat: (M,) bool, whether the normal means anything.
    """

    grid: Grid
    T_odom_sensor: F64
    table: NDArray[np.int64]
    slots: NDArray[np.int32]
    start: NDArray[np.int32]
    other: NDArray[np.int32]
    of_point: NDArray[np.int32]
    counts: NDArray[Any]
    size_m: F64
    centre: F64
    normal: F64
    flat: NDArray[np.bool_]

    @classmethod
    def of(
        cls, points: NDArray[np.float32], counts: NDArray[np.int32], T_odom_sensor: F64, grid: Grid
    ) -> Cells:
        """Cells of thinned points (N, 3), sensor frame, each the mean of so many (N,)."""
        everywhere = np.ones(len(points), np.bool_)
        table, slots, keys, _, _, cell = occupied(grid.warped(points), 1.0, everywhere)
        order = np.argsort(keys)
        rank = np.full(len(keys) + 1, -1, np.int32)
        rank[order] = np.arange(len(keys), dtype=np.int32)
        slots, cell = rank[slots], rank[cell]
        start, other = segments.neighbours(keys[order])
        total, centre, normal, flat = segments.normals(points, counts, cell, start, other)
        size = np.maximum(grid.near_m, grid.slope * np.linalg.norm(centre, axis=1))
        around = start, other, cell
        return cls(grid, T_odom_sensor, table, slots, *around, total, size, centre, normal, flat)

    def __len__(self) -> int:
        """Number of cells."""
        return len(self.counts)

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
        part, count = segments.divide(self.start, self.other, member, *surface, by_surface)
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
        _values_at(self.grid.warped(there), self.table, self.slots, values, out)
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
def _values_at(warped, table, slots, values, out):  # type: ignore[no-untyped-def]
    """The kernel of `Cells.at`."""
    last = values.shape[1]
    for row in range(len(warped)):
        key = voxel_key(warped[row, 0], warped[row, 1], warped[row, 2], 1.0)
        if key == EMPTY:
            continue
        slot = find_slot(table, key)
        if table[slot] != EMPTY:
            out[row, :last] = values[slots[slot]]
            out[row, last] = 1.0
            continue
        found = 0
        for di in range(-1, 2):
            for dj in range(-1, 2):
                for dk in range(-1, 2):
                    slot = find_slot(table, key + (di << 42) + (dj << 21) + dk)
                    if table[slot] != EMPTY:
                        for column in range(last):
                            out[row, column] += values[slots[slot], column]
                        found += 1
        if found:
            for column in range(last):
                out[row, column] /= found
            out[row, last] = 0.5
