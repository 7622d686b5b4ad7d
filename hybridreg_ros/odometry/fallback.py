# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fallback without a network: ICP in the same map, with kiss-icp as the second opinion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.kiss import KissRegistration
from hybridreg_ros.odometry.refine import assess, refine

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.localmap import LocalMap
    from hybridreg_ros.odometry.preprocess import Cloud, SensorModel
    from hybridreg_ros.odometry.refine import Fit

    F64 = NDArray[np.float64]

_GUESS_POINTS = 400


class Fallback:
    """Registration without a network (the branch named kiss_icp).

    `follow` refines the prediction point to plane, which is enough while the sensor moves evenly.
    `locate` scores guesses on the coarse level of the map and pulls the best one in there first.
    `second_opinion` asks kiss-icp's point-to-point registration; with `engine: kiss-icp` that is
    the only way.

    Args:
        config: settings.
        sensor: voxel size and ranges.
        local_map: the map that both branches share; kiss-icp sees a mirror of it.
    """

    def __init__(self, config: OdometryConfig, sensor: SensorModel, local_map: LocalMap) -> None:
        self._config = config
        self._map = local_map
        self._version = local_map.version
        voxel = sensor.voxel_size_m
        section = config.fallback
        self._kiss = KissRegistration(
            voxel,
            config.map.reach_m or sensor.max_range_m,
            config.map.points_per_voxel,
            section.max_iterations,
            section.threads,
            section.initial_threshold_m or 2.0 * voxel,
            section.min_motion_m or 0.1 * voxel,
        )

    def locate(
        self, cloud: Cloud, guesses: Sequence[F64], weights: NDArray[np.floating] | None = None
    ) -> Fit:
        """Pose of a cloud in the map.

        Args:
            cloud: the preprocessed scan.
            guesses: (4, 4) poses to start from.
            weights: (K,) trust per registered point, or None.

        Raises:
            RegistrationError: kiss-icp is the engine and cannot register these points.
        """
        guess = self._best(cloud.icp_points, guesses)
        if self._config.fallback.engine == 'kiss-icp':
            return self.second_opinion(cloud, guess, weights)
        return refine(cloud.icp_points, guess, self._map, self._config.refine, weights)

    def follow(
        self, cloud: Cloud, predicted: F64, weights: NDArray[np.floating] | None = None
    ) -> Fit:
        """Pose of a cloud that is near the prediction; arguments as `locate`."""
        return refine(
            cloud.icp_points, predicted, self._map, self._config.refine, weights, 'middle'
        )

    def second_opinion(
        self, cloud: Cloud, guess: F64, weights: NDArray[np.floating] | None = None
    ) -> Fit:
        """Pose by kiss-icp's registration, polished point to plane; arguments as `locate`.

        Raises:
            RegistrationError: kiss-icp cannot register these points.
        """
        self._mirror()
        points, section = cloud.icp_points, self._config.fallback
        trusted = points if weights is None else points[weights > 0.5]
        some = trusted[:: max(1, -(-len(trusted) // section.max_points))]
        pose = self._kiss.align(some, guess)
        if section.polish:
            return refine(points, pose, self._map, self._config.refine, weights, 'fine')
        return assess(points, pose, self._map, self._config.refine, weights)

    def learn(self, predicted: F64, pose: F64) -> None:
        """Tell kiss-icp's threshold how good the prediction was."""
        self._kiss.learn(predicted, pose)

    def update(self, points: NDArray[np.floating], T_odom_sensor: F64) -> None:
        """Say that static points (N, 3), sensor frame, entered the map at a pose.

        The mirror follows at once while kiss-icp makes every pose; otherwise it is built anew
        when kiss-icp is asked.
        """
        if self._config.fallback.engine == 'kiss-icp' and self._version == self._map.version:
            self._kiss.update(points, T_odom_sensor)
        else:
            self._version = -1

    def _mirror(self) -> None:
        if self._version != self._map.version:
            self._kiss.rebuild(self._map.fine.points())
            self._version = self._map.version

    def _best(self, points: NDArray[np.float32], guesses: Sequence[F64]) -> F64:
        """The guess under which the points lie nearest to the map."""
        if len(guesses) == 1:
            return guesses[0]
        some = points[:: max(1, len(points) // _GUESS_POINTS)]
        return min(guesses, key=lambda T: self._map.coarse.distance(some, T))


def turned(pose: F64, angle_deg: float) -> list[F64]:
    """A pose turned by an angle about each axis of the sensor, both ways."""
    turns = [s * np.deg2rad(angle_deg) * axis for axis in np.eye(3) for s in (1.0, -1.0)]
    return [pose @ se3.transform(se3.so3_exp(w), np.zeros(3)) for w in turns]
