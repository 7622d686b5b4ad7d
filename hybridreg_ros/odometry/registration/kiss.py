# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""kiss-icp's registration, with guards for everything that makes it abort the process."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import DependencyError, RegistrationError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

MIN_POINTS = 10
LARGEST_COORDINATE_M = 1e6


def require_kiss_icp() -> None:
    """Say how to install it.

    Raises:
        DependencyError: kiss-icp is not installed.
    """
    try:
        import kiss_icp  # noqa: F401
    except ImportError:
        raise DependencyError(
            'kiss-icp is not installed: pip install "kiss-icp>=1.3,<2"'
        ) from None


def guarded(points: NDArray[np.floating]) -> F64:
    """Points that kiss-icp can take: (N, 3) float64, contiguous, finite, not absurdly far."""
    rows = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
    with np.errstate(invalid='ignore'):
        sane = (np.abs(rows) < LARGEST_COORDINATE_M).all(axis=1)
    return rows if sane.all() else np.ascontiguousarray(rows[sane])


class KissRegistration:
    """kiss-icp's point-to-point registration on a copy of the local map.

    Args:
        voxel_size_m: voxel of the map.
        max_range_m: map points farther from the sensor are dropped by kiss-icp.
        points_per_voxel: most points kept per voxel.
        max_iterations: bound on the iterations of one registration, so also on its time.
        threads: threads of one registration.
        convergence: a step of a smaller norm (metres, radians) ends it (kiss-icp: 1e-4).

    Raises:
        DependencyError: kiss-icp is not installed.
    """

    def __init__(
        self,
        voxel_size_m: float,
        max_range_m: float,
        points_per_voxel: int = 20,
        max_iterations: int = 100,
        threads: int = 1,
        convergence: float = 1e-4,
    ) -> None:
        require_kiss_icp()
        from kiss_icp.mapping import VoxelHashMap
        from kiss_icp.registration import Registration

        self._map = VoxelHashMap(voxel_size_m, max_range_m, points_per_voxel)
        self._registration = Registration(max_iterations, convergence, threads)

    def align(self, points: NDArray[np.floating], guess: F64, reach_m: float) -> F64:
        """Register points with the map.

        Args:
            points: (N, 3), sensor frame, metres, thinned.
            guess: (4, 4) T_odom_sensor to start from.
            reach_m: standard deviation of its error, metres, > 0; partners are looked for within
                three of them.

        Returns:
            T_odom_sensor (4, 4).

        Raises:
            RegistrationError: too few points, an empty map, a guess that is no rigid transform,
                or a pose that is not finite came out.
        """
        usable = guarded(points)
        if len(usable) < MIN_POINTS or self._map.empty():
            raise RegistrationError(
                f'kiss-icp needs a map and {MIN_POINTS} points, found {len(usable)} points'
            )
        if not se3.is_rigid(guess) or np.abs(guess).max() > LARGEST_COORDINATE_M:
            raise RegistrationError('kiss-icp: the first guess is not a rigid transform in range')
        pose = np.asarray(
            self._registration.align_points_to_map(
                usable, self._map, guess, 3.0 * reach_m, reach_m
            )
        )
        if not se3.is_rigid(pose):
            raise RegistrationError('kiss-icp: the pose found is not a rigid transform')
        return se3.orthonormalise(pose)

    def rebuild(self, points: NDArray[np.floating]) -> None:
        """Start again from the points (N, 3), odom frame, of the local map."""
        self._map.clear()
        usable = guarded(points)
        if len(usable):
            self._map.add_points(usable)
