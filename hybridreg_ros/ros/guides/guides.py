# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Guides: those that the parameters ask for, one after the other, and the motion they correct."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.motion.guided import GuidedMotion
from hybridreg_ros.odometry.motion.prediction import Motion
from hybridreg_ros.ros.guides.frame_guess import FrameGuess
from hybridreg_ros.ros.guides.gyro import Gyro

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rclpy.node import Node

    from hybridreg_ros.core.scan import Scan
    from hybridreg_ros.ros.extrinsic import Extrinsic
    from hybridreg_ros.ros.node_config import NodeConfig


class Guides:
    """A gyroscope corrects the turn of constant velocity; a guess frame replaces both."""

    def __init__(self, node: Node, config: NodeConfig, extrinsic: Extrinsic) -> None:
        """Subscribe to what is asked for.

        Args:
            node: owner of the subscriptions.
            config: what is asked for.
            extrinsic: pose of the sensor in the base.

        Raises:
            DependencyError: a guess frame needs tf2_msgs, which is not installed.
        """
        self._gyro = Gyro(node) if config.use_imu else None
        self._frame: FrameGuess | None = None
        self._motion = Motion()
        self._planar, self._extrinsic = config.planar, extrinsic
        self._log = node.get_logger()
        if config.guess_frame:
            self._frame = FrameGuess(
                node, config.guess_frame, lambda *edge: config.odom_frame in edge
            )
            if config.publish_tf and not config.invert_tf:
                node.get_logger().warning(
                    'guess_frame and publish_tf: the base gets a second parent on /tf; set '
                    'invert_tf, or publish_tf to false'
                )

    @property
    def states(self) -> dict[str, str]:
        """Name of each guide with 'used' or why it is not."""
        named = (('imu', self._gyro), ('guess', self._frame))
        states = {name: guide.state for name, guide in named if guide is not None}
        return states if self._gyro is None else {**states, 'level': self._gyro.level}

    def motion(self) -> Motion:
        """A new motion model that follows the guides."""
        guided = self._gyro is not None or self._frame is not None
        self._motion = GuidedMotion(self._correct) if guided else Motion()
        return self._motion

    def up(self, stamp: int) -> NDArray[np.float64] | None:
        """Direction (3,) away from gravity, sensor frame, at the first cloud; None = unknown."""
        if self._gyro is None:
            return None
        up = self._gyro.up(stamp)
        if up is None:
            self._log.warning(f'first pose {self._gyro.level}')
        return up

    def begin(self, scan: Scan) -> None:
        """A scan is about to be stepped: by its mean rate it is deskewed."""
        frame = scan.frame_id.lstrip('/')
        if self._planar and (T_base_sensor := self._extrinsic.of(frame)) is not None:
            self._motion.up = T_base_sensor[2, :3]
        if self._frame is not None:
            self._frame.sensor_frame = frame
        if self._gyro is None:
            return
        self._gyro.sensor_frame = frame
        if scan.times is None or len(scan) == 0 or not isinstance(self._motion, GuidedMotion):
            return
        first, last = (round(t * NS_PER_S) for t in (scan.times.min(), scan.times.max()))
        rate = self._gyro.rate(scan.stamp + first, scan.stamp + last)
        if rate is not None:
            self._motion.turn(rate)

    def _correct(self, since: int, until: int, steady: NDArray[np.float64]) -> NDArray[np.float64]:
        for guide in (self._gyro, self._frame):
            if guide is not None:
                steady = guide(since, until, steady)
        return steady
