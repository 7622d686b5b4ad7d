# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Requests: what others ask of a running node, by service and by ~/initial_pose."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from std_srvs.srv import Trigger

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.loaders.clouds import write_cloud
from hybridreg_ros.ros import topics
from hybridreg_ros.ros.conversions import from_pose
from hybridreg_ros.ros.transforms import pose_matrix

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from rclpy.node import Node

    from hybridreg_ros.ros.journal import Journal
    from hybridreg_ros.ros.node_config import NodeConfig


class Asked(Protocol):
    """What requests are carried out on."""

    paused: bool

    def restart(self, T_odom_start: NDArray[np.float64]) -> None:
        """Begin anew, the base at a pose (4, 4)."""

    def map_points(self) -> NDArray[np.float32] | None:
        """Points (N, 3) of the map, odom frame; None before there is one."""


class Requests:
    """Services and the topic ~/initial_pose."""

    def __init__(
        self, node: Node, asked: Asked, config: Callable[[], NodeConfig], journal: Journal
    ) -> None:
        """Offer the services.

        Args:
            node: owner of the services.
            asked: who carries them out.
            config: gives the present parameters.
            journal: for warnings.
        """
        self._asked, self._config, self._journal = asked, config, journal
        for service, answer in (
            (topics.RESET, self._on_reset),
            (topics.RESET_TO_POSE, self._on_reset_to_pose),
            (topics.SAVE_MAP, self._on_save_map),
            (topics.PAUSE, self._on_pause),
            (topics.RESUME, self._on_resume),
        ):
            node.create_service(Trigger, service.name, answer)
        node.create_subscription(
            PoseWithCovarianceStamped,
            topics.INITIAL_POSE.name,
            self._on_initial_pose,
            topics.INITIAL_POSE.depth,
        )

    def _on_reset(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        """Start again at the origin with an empty map."""
        self._asked.restart(np.eye(4))
        response.success, response.message = True, 'pose and map cleared'
        return response

    def _on_reset_to_pose(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        """Start again at the parameter initial_pose with an empty map."""
        values = self._config().initial_pose
        self._asked.restart(pose_matrix(values))
        response.success = True
        response.message = f'map cleared, pose is {" ".join(f"{v:g}" for v in values)}'
        return response

    def _on_initial_pose(self, msg: PoseWithCovarianceStamped) -> None:
        """Start again at a pose; its covariance is not used."""
        frame, odom_frame = msg.header.frame_id.lstrip('/'), self._config().odom_frame
        try:
            T_odom_start = from_pose(msg.pose.pose)
        except FileFormatError as error:
            self._journal.warn('initial_pose', str(error))
            return
        if frame not in ('', odom_frame) or not np.isfinite(T_odom_start).all():
            text = f'expected a finite pose in frame {odom_frame}, found frame {frame!r}'
            self._journal.warn('initial_pose', text)
            return
        self._asked.restart(T_odom_start)

    def _on_save_map(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        """Write the static points of the local map, odom frame, to the parameter map_file."""
        path = Path(self._config().map_file).expanduser().resolve()
        points = self._asked.map_points()
        if points is None:
            response.message = 'no map yet: the node is starting'
            return response
        try:
            write_cloud(path, points)
        except FileFormatError as error:
            response.message = str(error)
            return response
        response.success = len(points) > 0
        response.message = f'{len(points)} points in {path}'
        return response

    def _on_pause(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        """Ignore (and count) clouds from now on."""
        self._asked.paused = True
        response.success, response.message = True, 'paused: clouds are counted and dropped'
        return response

    def _on_resume(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        """Process clouds again."""
        self._asked.paused = False
        response.success, response.message = True, 'resumed'
        return response
