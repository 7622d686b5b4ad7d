# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Which points of one cloud have a neighbour in another, by a grid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.se3 import apply

if TYPE_CHECKING:
    from numpy.typing import NDArray


def near_cells(
    points: NDArray[np.floating], others: NDArray[np.floating], cell_m: float
) -> NDArray[np.bool_]:
    """Which points (N, 3) have another (M, 3) in their cell of a grid or a cell beside it.

    True whenever another lies within `cell_m`, never beyond 3.5 times that.
    """
    if len(points) == 0 or len(others) == 0:
        return np.zeros(len(points), np.bool_)
    low = np.minimum(points.min(0), others.min(0))
    mine = np.floor((points - low) / cell_m).astype(np.int64) + 1
    their = np.floor((others - low) / cell_m).astype(np.int64) + 1
    size = np.maximum(mine.max(0), their.max(0)) + 2
    step = np.array([size[1] * size[2], size[2], 1])
    known = _distinct(their @ step)
    for along in step:  # each cell and those beside it, one axis after the other
        known = _distinct((known[:, None] + along * np.array([-1, 0, 1])).reshape(-1))
    key = mine @ step
    near: NDArray[np.bool_] = known[np.minimum(np.searchsorted(known, key), len(known) - 1)] == key
    return near


def _distinct(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Different keys (K,) in order; faster than `np.unique`, which hashes."""
    keys = np.sort(keys)
    first: NDArray[np.int64] = keys[np.append(True, keys[1:] != keys[:-1])]
    return first


def overlap_share(
    source: NDArray[np.floating],
    target: NDArray[np.floating],
    T_target_source: NDArray[np.float64],
    radius_m: float,
) -> float:
    """Share of source points (N, 3) with a target point (M, 3) within about `radius_m`."""
    near = near_cells(apply(T_target_source, source.astype(np.float64)), target, 0.6 * radius_m)
    return float(near.mean()) if len(near) else 0.0
