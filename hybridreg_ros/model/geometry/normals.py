# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Surface normals from neighbour lists that the pyramid has searched anyway."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.eigen import smallest_axis
from hybridreg_ros.core.jit import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MIN_NEIGHBOURS = 4
_MOST = 12


@compiled
def surface_normals(points: NDArray[np.float32], near: NDArray[np.int32]) -> NDArray[np.float32]:
    """Unit normal of the plane through the nearest neighbours of each point.

    Args:
        points: (N, 3) float32.
        near: (N, H) int32 neighbours, nearest first, the point itself included, padded with N;
            the first 12 are used.

    Returns:
        (N, 3) float32 of arbitrary sign; zero where fewer than four neighbours are known.
    """
    n = points.shape[0]
    out = np.zeros((n, 3), np.float32)
    for i in range(n):
        x = y = z = xx = xy = xz = yy = yz = zz = 0.0
        count = 0
        for h in range(min(near.shape[1], _MOST)):
            j = near[i, h]
            if j >= n:
                break
            dx = float(points[j, 0] - points[i, 0])
            dy = float(points[j, 1] - points[i, 1])
            dz = float(points[j, 2] - points[i, 2])
            x, y, z = x + dx, y + dy, z + dz
            xx, xy, xz = xx + dx * dx, xy + dx * dy, xz + dx * dz
            yy, yz, zz = yy + dy * dy, yz + dy * dz, zz + dz * dz
            count += 1
        if count < _MIN_NEIGHBOURS:
            continue
        s = 1.0 / count
        x, y, z = x * s, y * s, z * s
        _, _, _, nx, ny, nz = smallest_axis(
            xx * s - x * x,
            xy * s - x * y,
            xz * s - x * z,
            yy * s - y * y,
            yz * s - y * z,
            zz * s - z * z,
        )
        out[i, 0], out[i, 1], out[i, 2] = nx, ny, nz
    return out
