# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Surfaces: pairs of scan points with the map, their residuals and robust scales."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.odometry.registration import kernels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.map.local_map import VoxelLevel

_RANGE_GROUPS = 6
_RANGE_GROUP = 100
"""Points are grouped by range into at most so many groups of at least so many, each with a scale
of its own: the noise of a depth camera grows with the square of the range."""


class Surfaces:
    """Pairs of scan points with local surfaces of the map (buffers reused over iterations)."""

    def __init__(self, count: int) -> None:
        self.kind = np.zeros(count, np.int8)
        self.anchor = np.zeros((count, 3))
        self.normal = np.zeros((count, 3))
        self.variance = np.zeros(count)
        self.born = np.zeros(count)
        self.residual = np.full(count, np.inf)

    def search(
        self,
        points: NDArray[np.float64],
        T: NDArray[np.float64],
        levels: tuple[VoxelLevel, VoxelLevel, VoxelLevel],
        update: int,
    ) -> None:
        """Pair points with the surfaces of a level, or of the next wider one that has some."""
        kernels.associate(
            points,
            T[:3, :3].copy(),
            T[:3, 3].copy(),
            levels[0].grid,
            levels[1].grid,
            levels[2].grid,
            update,
            self.kind,
            self.anchor,
            self.normal,
            self.variance,
            self.born,
        )

    def measure(self, points: NDArray[np.float64], T: NDArray[np.float64]) -> None:
        """Distances of points (N, 3) at a pose (4, 4) to their surfaces, into `residual`."""
        kernels.residuals(
            points,
            T[:3, :3].copy(),
            T[:3, 3].copy(),
            self.kind,
            self.anchor,
            self.normal,
            self.residual,
        )

    def scales(self, order: NDArray[np.int64], low: float, high: float) -> NDArray[np.float64]:
        """Robust standard deviation of plane residuals per point (N,), as it grows with the range.

        Args:
            order: (N,) rows of the points by range.
            low: floor, metres.
            high: ceiling, metres.
        """
        spread: NDArray[np.float64] = _scales(self.residual, self.kind, order, low, high)
        return spread


@compiled
def _scales(residual, kind, order, low, high):  # type: ignore[no-untyped-def]
    """Robust standard deviation of the plane residuals per point (N,), over groups by range."""
    n = len(order)
    planes = np.empty(n)
    place = np.empty(n)
    count = 0
    for k in range(n):
        if kind[order[k]] == kernels.PLANE:
            planes[count] = residual[order[k]]
            place[count] = k
            count += 1
    groups = max(1, min(_RANGE_GROUPS, count // _RANGE_GROUP))
    spread = np.empty(groups)
    middle = np.empty(groups)
    ends = np.linspace(0, count, groups + 1).astype(np.int64)
    for g in range(groups):
        if count == 0:
            spread[g], middle[g] = high, 0.0
            continue
        spread[g] = 1.4826 * np.median(planes[ends[g] : ends[g + 1]])
        middle[g] = place[(ends[g] + ends[g + 1]) // 2]
    out = np.empty(n)
    g = 0
    for k in range(n):
        while g + 1 < groups and middle[g + 1] <= k:
            g += 1
        value = spread[g]
        if k > middle[g] and g + 1 < groups:
            share = (k - middle[g]) / (middle[g + 1] - middle[g])
            value += share * (spread[g + 1] - spread[g])
        out[order[k]] = min(max(value, low), high)
    return out
