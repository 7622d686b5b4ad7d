# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fallback without a network: kiss-icp's registration in the same map, refined like any pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.map.local_map import POINTS_PER_VOXEL
from hybridreg_ros.odometry.map.thinning import first_per_voxel
from hybridreg_ros.odometry.registration.alignment import align_scan, pull_in
from hybridreg_ros.odometry.registration.kiss import KissRegistration

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.map.local_map import LocalMap
    from hybridreg_ros.odometry.motion.prediction import Expected
    from hybridreg_ros.odometry.preprocess import SensorModel
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan
    from hybridreg_ros.odometry.registration.alignment import Basin, Fit

    F64 = NDArray[np.float64]

_THINNING, _MOST = 1.5, 2000
"""Edge of the cubes of which kiss-icp gets a point each, in its voxels; and points at most."""
_GUESS_POINTS = 400
_TURNS_DEG, _SHIFTS, _SEARCHED = (20.0, 40.0, 60.0), (1.0, 2.0, 3.0), 3
"""Guesses of a wide search: turns, shifts in coarse voxels, and how many are followed up."""
_NEAREST = 0.2
"""Partners are looked for at least so far away (standard deviation, in voxels): stored points
keep a distance from each other."""
_SAME = 0.5
"""Poses nearer to each other, in voxels and degrees, are refined to the same one."""
_OFF_RINGS = 2
"""Pairings on the coarse level that get a lidar off old rings (four do no better)."""


class Fallback:
    """Registration without a network (the branch named kiss_icp).

    Every pose is made by kiss-icp's point-to-point registration against the middle level of the
    local map, whose voxels have the size that suits it (in the fine ones it finds no partner for
    a point after a quick turn), and then refined point to plane, as the network's poses are.
    `follow` starts it at a guess; `locate` pulls the guess in on the coarse level first.

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
            initial_threshold_m=2.0 * voxel,
            min_motion_m=0.1 * voxel,
            convergence=0.008 * voxel,
        )

    def follow(
        self,
        cloud: PreprocessedScan,
        guess: F64,
        weights: NDArray[np.floating] | None = None,
        basin: Basin = 'fine',
        prior: Expected | None = None,
    ) -> Fit:
        """Pose of a cloud near a guess.

        Args:
            cloud: the preprocessed scan.
            guess: (4, 4) pose to start from.
            weights: (K,) trust per registered point, or None.
            basin: level on which the refinement starts.
            prior: what the motion so far says, or None.

        Raises:
            RegistrationError: kiss-icp cannot register these points.
        """
        pose = self._aligned(cloud, guess, weights)
        return self._refined(cloud, pose, weights, basin, prior)

    def follow_near(
        self,
        cloud: PreprocessedScan,
        guess: F64,
        weights: NDArray[np.floating] | None,
        prior: Expected,
        reach_m: float,
        known: F64 | None,
    ) -> Fit | None:
        """The same, with partners no farther than predictions have been off of late.

        Args:
            cloud: the preprocessed scan.
            guess: (4, 4) pose to start from.
            weights: (K,) trust per registered point, or None.
            prior: what the motion so far says.
            reach_m: how far predictions have been off of late, metres.
            known: (4, 4) pose that has been found already, or None.

        Returns:
            Its outcome; None when kiss-icp brings a lidar to the known pose, whose refinement is
            the dearest of all.

        Raises:
            RegistrationError: kiss-icp cannot register these points.
        """
        pose = self._aligned(cloud, guess, weights, max(reach_m, _NEAREST * self._voxel_m))
        if known is not None and not self._map.noisy and self._are_same(known, pose):
            return None
        return self._refined(cloud, pose, weights, 'fine', prior)

    def _aligned(
        self,
        cloud: PreprocessedScan,
        guess: F64,
        weights: NDArray[np.floating] | None,
        reach_m: float | None = None,
    ) -> F64:
        """Pose (4, 4) by kiss-icp alone."""
        self._copy_map()
        points = cloud.icp_points
        trusted = points if weights is None else points[weights > 0.5]
        some = trusted[first_per_voxel(trusted, _THINNING * self._voxel_m)]
        some = some[:: max(1, -(-len(some) // _MOST))]
        return self._kiss.align(some, guess, reach_m)

    def _refined(
        self,
        cloud: PreprocessedScan,
        pose: F64,
        weights: NDArray[np.floating] | None,
        basin: Basin,
        prior: Expected | None,
    ) -> Fit:
        """A pose of kiss-icp laid on the surfaces of the map.

        It pairs points with points, so it lays the rings of a lidar on old rings. From there no
        surface of the fine level gets them off again; one of the coarse level does.
        """
        if basin == 'fine' and not self._map.noisy:
            pose = pull_in(cloud.icp_points, pose, self._map, weights, 'coarse', _OFF_RINGS)
        return align_scan(cloud, pose, self._map, weights, basin, prior)

    def _are_same(self, one: F64, other: F64) -> bool:
        """Whether the refinement leads from both poses to the same one."""
        off = se3.inverse(one) @ other
        shift = float(np.linalg.norm(off[:3, 3])) / (_SAME * self._map.fine.size_m)
        return max(shift, se3.rotation_angle_deg(off[:3, :3]) / _SAME) < 1.0

    def locate(
        self,
        cloud: PreprocessedScan,
        guesses: Sequence[F64],
        weights: NDArray[np.floating] | None = None,
        prior: Expected | None = None,
    ) -> Fit:
        """Pose of a cloud in the map, from the best of the guesses, pulled in; as `follow`."""
        guess = self._ranked(cloud.icp_points, guesses)[0]
        near = pull_in(cloud.icp_points, guess, self._map, weights, 'coarse')
        return self.follow(cloud, near, weights, 'middle', prior)

    def learn(self, predicted: F64, pose: F64) -> None:
        """Tell kiss-icp's threshold how good the prediction was."""
        self._kiss.learn(predicted, pose)

    def _copy_map(self) -> None:
        """Give kiss-icp the middle level of the map as it is now."""
        if self._copied != self._map.changes:
            self._kiss.rebuild(self._map.middle.points())
            self._copied = self._map.changes

    def search(self, cloud: PreprocessedScan, guess: F64) -> list[F64]:
        """The most promising poses far around a guess, best first: turned and shifted ones.

        Args:
            cloud: the preprocessed scan.
            guess: (4, 4) centre of the search.
        """
        guesses = [guess]
        for angle in _TURNS_DEG:
            guesses += turned(guess, angle)
        for cells in _SHIFTS:
            guesses += shifted(guess, cells * self._map.coarse.size_m)
        return self._ranked(cloud.icp_points, guesses)[:_SEARCHED]

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
