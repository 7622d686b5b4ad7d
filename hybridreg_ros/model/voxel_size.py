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
