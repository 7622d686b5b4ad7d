# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Voxel size from the clouds themselves, for any sensor, and a guard against wrong units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import RegistrationError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SAMPLE = 4_000
_ROOM_REACH_M, _ROOM_VOXEL_M = 4.0, 0.05
_STREET_REACH_M, _STREET_VOXEL_M = 24.0, 0.3
_OBJECT_REACH_M = 1.0
_MAX_REACH_M = 500.0
_MAX_RATIO = 50.0


def reach_m(points: NDArray[np.float32]) -> float:
    """Distance within which 90 % of the finite points lie from their median, metres.

    Args:
        points: (N, 3) float32, metres; 0 when none is finite.
    """
    sample = points[:: max(len(points) // _SAMPLE, 1)]
    sample = sample[np.isfinite(sample).all(axis=1)].astype(np.float64)
    if len(sample) == 0:
        return 0.0
    distance = np.linalg.norm(sample - np.median(sample, axis=0), axis=1)
    return float(np.percentile(distance, 90.0))


def choose_voxel_size_m(*clouds: NDArray[np.float32]) -> float:
    """One voxel size for clouds that are to be registered with each other.

    Rooms (90 % of the points within 4 m of the median) get 0.05 m, streets (24 m) 0.3 m, in
    between it grows with the reach; clouds smaller than 1 m are taken for single objects.

    Args:
        clouds: (N, 3) float32 each, metres.

    Raises:
        RegistrationError: a cloud has no extent, is far too large to be in metres, or the clouds
            differ in size as if one were in other units.
    """
    reaches = np.array([reach_m(c) for c in clouds])
    if (reaches <= 0.0).any():
        raise RegistrationError(
            'a cloud has no extent: expected at least 3 different finite points'
        )
    if reaches.max() > _MAX_REACH_M:
        raise RegistrationError(
            f'a cloud reaches {reaches.max():.4g} m: expected metres, this looks like '
            'millimetres; divide the coordinates by 1000'
        )
    if reaches.max() / reaches.min() > _MAX_RATIO:
        raise RegistrationError(
            f'the clouds reach {reaches.min():.4g} m and {reaches.max():.4g} m: one of them seems '
            'to be in other units; give both in metres'
        )
    reach = float(np.exp(np.log(reaches).mean()))
    if reach < _OBJECT_REACH_M:
        return _ROOM_VOXEL_M * reach / _OBJECT_REACH_M
    share = np.log(reach / _ROOM_REACH_M) / np.log(_STREET_REACH_M / _ROOM_REACH_M)
    grown = _ROOM_VOXEL_M * (_STREET_VOXEL_M / _ROOM_VOXEL_M) ** float(np.clip(share, 0.0, 1.0))
    return float(grown)


def budget_voxel_size_m(
    *clouds: NDArray[np.float32], smallest_m: float, max_points: int, max_superpoints: int
) -> float:
    """The voxel at which no cloud holds more occupied voxels than the budget, at all levels.

    Occupied voxels of surfaces fall with the square of the voxel, so a few steps suffice. The
    result is within 3 % of the smallest voxel that keeps the budget.

    Args:
        clouds: (N, 3) float32 each, metres; rows with NaN or inf are ignored.
        smallest_m: lower bound, metres; returned when the clouds keep the budget there.
        max_points: maximum occupied voxels of the finest level.
        max_superpoints: maximum occupied voxels of the coarsest level, eight voxels wide.
    """
    voxel_m = smallest_m
    for cloud in clouds:
        points = cloud[np.isfinite(cloud).all(axis=1)]
        for size, limit in ((1.0, max_points), (8.0, max_superpoints)):
            voxel_m = _smallest_within(points, voxel_m, size, limit)
    return voxel_m


def _smallest_within(
    points: NDArray[np.float32], voxel_m: float, size: float, limit: int
) -> float:
    """`voxel_m`, or the smallest larger one with at most `limit` cells of `size` voxels."""
    low = high = voxel_m
    while (count := _occupied(points, high * size)) > limit:
        low, high = high, high * max(np.sqrt(count / limit), 1.01)
    while high > 1.03 * low:
        middle = float(np.sqrt(low * high))
        if _occupied(points, middle * size) > limit:
            low = middle
        else:
            high = middle
    return float(high)


def _occupied(points: NDArray[np.float32], cell_m: float) -> int:
    """Number of cubic cells that hold a point."""
    cells = np.floor(points / cell_m).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    span = cells.max(axis=0, initial=0) + 1
    return len(np.unique((cells[:, 0] * span[1] + cells[:, 1]) * span[2] + cells[:, 2]))
