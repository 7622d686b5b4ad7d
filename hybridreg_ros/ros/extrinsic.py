# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Extrinsic: the pose of the sensor in the base, by parameter or /tf_static."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.ros.transforms import StaticListener, pose_matrix

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rclpy.node import Node

    from hybridreg_ros.ros.node_config import NodeConfig


class Extrinsic:
    """Looks the pose up and keeps it until a reset: another one would make the odometry jump.

    Attributes:
        waiting_for: text while it is not known, else ''.
    """

    def __init__(self, node: Node, config: NodeConfig) -> None:
        """Subscribe to /tf_static if the pose comes from there.

        Raises:
            DependencyError: it shall come from there, and tf2_msgs is missing.
        """
        self.waiting_for = ''
        self._log = node.get_logger()
        self._base = config.base_frame
        self._given = None
        self._used: NDArray[np.float64] | None = None
        self._listener: StaticListener | None = None
        if config.extrinsic_source == 'parameter':
            self._given = pose_matrix(config.extrinsic)
        elif config.base_frame:
            self._listener = StaticListener(node)

    def forget(self) -> None:
        """The pose is taken again: the odometry begins anew."""
        self._used = None

    def of(self, sensor_frame: str) -> NDArray[np.float64] | None:
        """Pose (4, 4) of a frame in the base, None while it is not known (`waiting_for`)."""
        self.waiting_for = ''
        if self._base in ('', sensor_frame):
            return np.eye(4)
        if self._given is not None:
            return self._given
        T = None if self._listener is None else self._listener.lookup(self._base, sensor_frame)
        if T is None and self._used is None:
            self.waiting_for = (
                f'odometry held back: /tf_static does not connect {self._base} and {sensor_frame}'
            )
            self._log.warning(self.waiting_for, throttle_duration_sec=10.0)
        elif self._used is None:
            self._used = T
        elif T is not None and not np.allclose(T, self._used, atol=1e-6):
            text = f'/tf_static has moved {sensor_frame} in {self._base}: used after ~/reset'
            self._log.warning(text, throttle_duration_sec=10.0)
        return self._used
