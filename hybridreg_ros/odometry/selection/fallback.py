# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fallback without a network: kiss-icp's registration in the same map, refined like any pose."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.map.local_map import POINTS_PER_VOXEL
from hybridreg_ros.odometry.map.thinning import first_per_voxel
from hybridreg_ros.odometry.registration.alignment import align_scan, pull_in
from hybridreg_ros.odometry.registration.kiss import KissRegistration

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.map.local_map import LocalMap
    from hybridreg_ros.odometry.preprocess import SensorModel
    from hybridreg_ros.odometry.registration.alignment import Basin, Fit
    from hybridreg_ros.odometry.selection.candidates import Sought

    F64 = NDArray[np.float64]

_THINNING, _MOST = 1.5, 2000
"""Edge of the cubes of which kiss-icp gets a point each, in its voxels; and points at most."""
_GUESS_POINTS = 400
_TURNS_DEG, _SHIFTS, _SEARCHED = (20.0, 40.0, 60.0), (1.0, 2.0, 3.0), 3
"""Guesses of a wide search: turns, shifts in coarse voxels, and how many are followed up."""
_NEAREST, _WIDE = 0.2, 2.0
"""Partners are looked for at least, and from guesses that may be anywhere, so far away (standard
deviation, in voxels): stored points keep a distance from each other."""
_OFF_RINGS = 2
"""Pairings on the coarse level that get a lidar off old rings (four do no better)."""


class Fallback:
    """Registration without a network (the branch named kiss_icp).

    Every pose is made by kiss-icp's point-to-point registration against the middle level of the
    local map, whose voxels have the size that suits it (in the fine ones it finds no partner for
    a point after a quick turn), and then refined point to plane, as the network's poses are.

    Args:
        config: settings.
        sensor: ranges.
        local_map: the map that both branches share; kiss-icp gets a copy of its middle level.
    """

    def __init__(self, config: OdometryConfig, sensor: SensorModel, local_map: LocalMap) -> None:
        self._map = local_map
        self._copied = -1
        voxel = self._voxel_m = local_map.middle.size_m
        self._kiss = KissRegistration(
            voxel,
            config.map.reach_m or sensor.max_range_m,
            POINTS_PER_VOXEL,
            convergence=0.008 * voxel,
        )

    def ways(
        self, scan: Sought, guesses: Sequence[F64], wide: bool
    ) -> Iterator[Callable[[], Fit]]:
        """Ways to register a scan, the least search first; each raises RegistrationError.

        A crowd that comes into view draws kiss-icp away from the pose by more than predictions
        are usually off; with near partners alone it does not. So the first way looks no farther
        than that, the second one pulls the best guess in on the coarse level, and the others
        start from the most promising ones that are turned and shifted.

        Args:
            scan: what is sought.
            guesses: (4, 4) poses to start from, the likeliest first.
            wide: whether turned and shifted ones are looked at too.
        """
        if scan.expected is not None:
            reach_m = max(scan.expected.shift_m, _NEAREST * self._voxel_m)
            yield partial(self._follow, scan, guesses[0], reach_m, 'fine')
        yield partial(self._locate, scan, guesses)
        if wide:
            for guess in self.search(scan.cloud.icp_points, guesses[0]):
                yield partial(self._locate, replace(scan, prior=None), [guess])

    def _follow(self, scan: Sought, guess: F64, reach_m: float, basin: Basin) -> Fit:
        """Pose of a scan near a guess, by partners so far away, laid on surfaces of the map.

        kiss-icp pairs points with points, so it lays the rings of a lidar on old rings. From there
        no surface of the fine level gets them off again; one of the coarse level does.
        """
        self._copy_map()
        trusted = scan.cloud.icp_points[scan.trust > 0.5]
        some = trusted[first_per_voxel(trusted, _THINNING * self._voxel_m)]
        some = some[:: max(1, -(-len(some) // _MOST))]
        pose = self._kiss.align(some, guess, reach_m)
        if basin == 'fine' and not self._map.noisy:
            points = scan.cloud.icp_points
            pose = pull_in(points, pose, self._map, scan.trust, 'coarse', _OFF_RINGS)
        return align_scan(scan.cloud, pose, self._map, scan.trust, basin, scan.prior)

    def _locate(self, scan: Sought, guesses: Sequence[F64]) -> Fit:
        """Pose of a scan from the best of the guesses, pulled in."""
        guess = self._ranked(scan.cloud.icp_points, guesses)[0]
        near = pull_in(scan.cloud.icp_points, guess, self._map, scan.trust, 'coarse')
        return self._follow(scan, near, _WIDE * self._voxel_m, 'middle')

    def _copy_map(self) -> None:
        """Give kiss-icp the middle level of the map as it is now."""
        if self._copied != self._map.changes:
            self._kiss.rebuild(self._map.middle.points())
            self._copied = self._map.changes

    def search(self, points: NDArray[np.float32], guess: F64) -> list[F64]:
        """The most promising poses far around a guess, best first: turned and shifted ones.

        Args:
            points: (K, 3) that are registered, sensor frame, metres.
            guess: (4, 4) centre of the search.
        """
        guesses = [guess]
        for angle in _TURNS_DEG:
            guesses += turned(guess, angle)
        for cells in _SHIFTS:
            guesses += shifted(guess, cells * self._map.coarse.size_m)
        return self._ranked(points, guesses)[:_SEARCHED]

    def _ranked(self, points: NDArray[np.float32], guesses: Sequence[F64]) -> list[F64]:
        """Guesses by how near to the map they bring the points, best first."""
        some = points[:: max(1, len(points) // _GUESS_POINTS)]
        return sorted(guesses, key=lambda T: self._map.coarse.distance(some, T))


def turned(pose: F64, angle_deg: float) -> list[F64]:
    """A pose turned by an angle about each axis of the sensor, both ways."""
    turns = [s * np.deg2rad(angle_deg) * axis for axis in np.eye(3) for s in (1.0, -1.0)]
    return [pose @ se3.transform(se3.so3_exp(w), np.zeros(3)) for w in turns]


def shifted(pose: F64, distance_m: float) -> list[F64]:
    """A pose shifted by a distance along each axis of the sensor, both ways."""
    shifts = [s * distance_m * axis for axis in np.eye(3) for s in (1.0, -1.0)]
    return [pose @ se3.transform(np.eye(3), t) for t in shifts]
