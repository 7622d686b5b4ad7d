# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Nearest point of a cloud per cell, and the compiled steps of looking one up under a pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.core.pages import zeros
from hybridreg_ros.model.geometry.ops import bounds

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    Numbers = NDArray[np.integer]
    Space = tuple[Numbers, tuple[float, float, float], float]

_HALF_EXTENT_VOXELS = 250.0
_MOST_CELLS = 24_000_000


@compiled
def moved(T: F64, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A point under a transform (4, 4)."""
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )


@compiled
def cosine(T: F64, normals: F32, i: int, others: F32, j: int) -> float:
    """Cosine of the angle between normal i, turned by a transform (4, 4), and another normal j."""
    total = 0.0
    for k in range(3):
        turned = 0.0
        for m in range(3):
            turned += T[k, m] * normals[i, m]
        total += turned * others[j, k]
    return total


@compiled
def cell_point(x: float, y: float, z: float, space: Space) -> int:
    """The point that a grid (`Grid.space`) knows for a place, -1 for none."""
    grid, low, rate = space
    p = int(np.floor((x - low[0]) * rate))
    q = int(np.floor((y - low[1]) * rate))
    s = int(np.floor((z - low[2]) * rate))
    if not (0 <= p < grid.shape[0] and 0 <= q < grid.shape[1] and 0 <= s < grid.shape[2]):
        return -1
    found: int = int(grid[p, q, s]) - 1
    return found


@compiled
def _fill(grid: Numbers, points: F32, low: F64, cell: float) -> None:
    """Per cell, 1 + the point nearest to its centre among those in the 27 cells around, or 0."""
    shape = grid.shape
    at = np.empty(3, np.int64)
    for i in range(points.shape[0]):
        inside = True
        for k in range(3):
            at[k] = int(np.floor((points[i, k] - low[k]) / cell))
            inside &= 1 <= at[k] < shape[k] - 1
        if not inside:
            continue
        for x in range(at[0] - 1, at[0] + 2):
            for y in range(at[1] - 1, at[1] + 2):
                for z in range(at[2] - 1, at[2] + 2):
                    other = int(grid[x, y, z]) - 1
                    if other < 0:
                        grid[x, y, z] = i + 1
                        continue
                    cx = low[0] + (x + 0.5) * cell
                    cy = low[1] + (y + 0.5) * cell
                    cz = low[2] + (z + 0.5) * cell
                    new = (
                        (points[i, 0] - cx) ** 2
                        + (points[i, 1] - cy) ** 2
                        + (points[i, 2] - cz) ** 2
                    )
                    old = (
                        (points[other, 0] - cx) ** 2
                        + (points[other, 1] - cy) ** 2
                        + (points[other, 2] - cz) ** 2
                    )
                    if new < old:
                        grid[x, y, z] = i + 1


@dataclass(frozen=True, eq=False)
class Grid:
    """Nearest point of a cloud per cell, for look-ups that need no search.

    Attributes:
        nearest: (X, Y, Z) uint16, or int32 for many points: 1 + index of the point, 0 where there
            is none around.
        low: (3,) float64 corner, voxels.
        cell: side of a cell, voxels.
    """

    nearest: Numbers
    low: F64
    cell: float

    @classmethod
    def build(cls, points: F32, cell: float) -> Grid:
        """Sort points (N, 3) in; what is far from their median is left out.

        The reach around the median is 250 voxels, and less where that would be over 24 million
        cells: a cloud that fills all of space must not fill the memory.
        """
        centre, half = np.median(points, axis=0).astype(np.float64), _HALF_EXTENT_VOXELS
        first, last = bounds(points)
        while True:
            low = np.maximum(first - 2.0 * cell, centre - half)
            high = np.minimum(last + 3.0 * cell, centre + half)
            shape = np.ceil((high - low) / cell).astype(np.int64)
            if shape.prod() <= _MOST_CELLS:
                break
            half *= 0.9
        number = np.uint16 if len(points) < np.iinfo(np.uint16).max else np.int32
        grid = zeros((shape[0], shape[1], shape[2]), number)
        _fill(grid, points, low, cell)
        return cls(grid, low, cell)

    @cached_property
    def space(self) -> Space:
        """The grid as compiled functions take it: cells, corner, cells per voxel."""
        x, y, z = self.low.tolist()
        return self.nearest, (x, y, z), 1.0 / self.cell
