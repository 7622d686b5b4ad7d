# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""World: what is known of the surroundings, and what each scan adds to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.dynamics.classifier import Dynamics
from hybridreg_ros.odometry.keyframes import Keyframes
from hybridreg_ros.odometry.map.local_map import LocalMap
from hybridreg_ros.odometry.preprocess import certainty
from hybridreg_ros.odometry.visibility.sightings import Sightings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.keyframes import Keyframe
    from hybridreg_ros.odometry.preprocess import SensorModel
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan
    from hybridreg_ros.odometry.selection.candidates import Candidate
    from hybridreg_ros.odometry.visibility.range_image import RangeImage

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    Mask = NDArray[np.bool_]

_STATIC_BELOW = 0.3
"""Only points of a lower P(dynamic) enter the map."""


class World:
    """The map, the keyframes, what scans saw and what moves, in one odom frame.

    Args:
        config: settings.
        sensor: what the sensor is.

    Attributes:
        map: the local map, of static points.
        keyframes: what the network matches against.
        sightings: what the poses of later scans are judged by.
        dynamics: what moves.
    """

    def __init__(self, config: OdometryConfig, sensor: SensorModel) -> None:
        self._config = config
        self._sensor = sensor
        self.map = LocalMap(
            sensor.voxel_size_m,
            config.map.reach_m or sensor.max_range_m,
            sensor.kind == 'depth',
        )
        self.keyframes = Keyframes(config.keyframe, sensor.voxel_size_m)
        self.sightings = Sightings(sensor)
        self.dynamics = Dynamics(config.dynamics, sensor)

    def begin(self, cloud: PreprocessedScan, pose: F64, stamp: int) -> Keyframe:
        """Take a first scan at a pose (4, 4) as it is; it becomes a keyframe."""
        keyframe = self.keyframes.add(pose, stamp, cloud.map_points)
        self._open(cloud, pose, stamp)
        return keyframe

    def begin_again(self, cloud: PreprocessedScan, pose: F64, stamp: int) -> Keyframe:
        """Put the newest keyframe elsewhere; all else but older keyframes is forgotten."""
        self.forget()
        keyframe = self.keyframes.mend(pose, cloud.map_points)
        self._open(cloud, pose, stamp)
        return keyframe

    def moving(
        self, cloud: PreprocessedScan, pose: F64, stamp: int, static: F32 | None = None
    ) -> tuple[F32, RangeImage]:
        """P(dynamic) of the points (N,) of a scan, and what the scan saw.

        Args:
            cloud: the scan.
            pose: (4, 4) where it is.
            stamp: ns.
            static: (M,) P(static) of its thinned points by the network; None = not asked.
        """
        image = self.sightings.draw(cloud, pose)
        return self.dynamics.update(cloud, pose, image, stamp, static), image

    def add(
        self,
        cloud: PreprocessedScan,
        stamp: int,
        found: Candidate,
        dynamic: F32,
        image: RangeImage,
    ) -> Keyframe | None:
        """Add what stands still in a scan; take off the map what the scan shows to be gone.

        By a tentative pose later scans are judged, but it enters neither the map nor the past in
        which movers are looked for.

        Args:
            cloud: the scan.
            stamp: ns.
            found: where it is.
            dynamic: (N,) P(dynamic) of its points.
            image: what it saw.

        Returns:
            The keyframe that it has become, if one was due.
        """
        pose, still, keyframe = found.fit.T_odom_sensor, dynamic < _STATIC_BELOW, None
        enters = found.adds_to_map(self._config.gate.sure, self._sensor.voxel_size_m)
        if self.is_due(found, stamp):
            keyframe = self.keyframes.add(pose, stamp, cloud.map_points)
        if not found.tentative:
            self._remember(cloud, pose, stamp, image, still)
        if enters:
            self._write(cloud, pose, stamp, still)
        drawn = image if still.all() else image.only(cloud.usable & still)
        self.sightings.keep(drawn, () if keyframe is None else self.keyframes)
        return keyframe

    def is_due(self, found: Candidate, stamp: int) -> bool:
        """Whether a located scan must become a keyframe."""
        pose, seen = found.fit.T_odom_sensor, found.evidence.seen
        enters = found.adds_to_map(self._config.gate.sure, self._sensor.voxel_size_m)
        return enters and self.keyframes.wanted(pose, stamp, seen)

    def forget(self) -> None:
        """Forget all but the keyframes."""
        for part in (self.map, self.dynamics, self.sightings):
            part.clear()

    def _open(self, cloud: PreprocessedScan, pose: F64, stamp: int) -> None:
        """Let the map, the past and what was seen be those of one scan."""
        image, still = self.moving(cloud, pose, stamp)[1], np.ones(len(cloud.points), np.bool_)
        self._remember(cloud, pose, stamp, image, still)
        self._write(cloud, pose, stamp, still)
        self.sightings.keep(image, self.keyframes)

    def _remember(
        self, cloud: PreprocessedScan, pose: F64, stamp: int, image: RangeImage, still: Mask
    ) -> None:
        """Erase what an image shows to be gone; let movers of later scans be told by it."""
        if self._config.dynamics.enabled:
            gone = self.dynamics.vanished(image)
            if len(gone):
                self.map.erase(gone)
            rows = cloud.icp_rows[still[cloud.icp_rows]]
            self.dynamics.remember(image, se3.apply(pose, cloud.points[rows]), stamp)

    def _write(self, cloud: PreprocessedScan, pose: F64, stamp: int, still: Mask) -> None:
        """Add the still points to the map."""
        points = cloud.means[still[cloud.map_rows]].astype(np.float64)
        weights = certainty(points, self._sensor)
        self.map.update(se3.apply(pose, points), pose[:3, 3], weights, stamp)
