# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Guess: how the sensor has moved in another frame, such as that of wheel odometry, by /tf."""

from __future__ import annotations

import bisect
import threading
from collections import deque
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import DependencyError
from hybridreg_ros.ros.conversions import rotation, to_ns
from hybridreg_ros.ros.qos import profile
from hybridreg_ros.ros.topics import GUESS_TF
from hybridreg_ros.ros.transforms import StaticListener, message_type

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from rclpy.node import Node

    F64 = NDArray[np.float64]

_KEPT = 1000
_WAIT_S = 0.05
"""How long a step waits for a transform that has not come yet."""
_GAP_NS = 500_000_000
"""Between transforms farther apart nothing is interpolated."""


class _Pose(NamedTuple):
    stamp: int
    parent: str
    T_parent_child: F64


class FrameGuess:
    """Motion of the sensor in the guess frame; a guide of GuidedMotion.

    Attributes:
        sensor_frame: frame of the clouds.
        state: 'used', or why constant velocity is used instead.
    """

    def __init__(self, node: Node, guess_frame: str, is_own: Callable[[str, str], bool]) -> None:
        """Subscribe to /tf and /tf_static.

        Args:
            node: owner of the subscriptions.
            guess_frame: fixed frame of the other odometry.
            is_own: tells by parent and child whether the node itself sends a transform.

        Raises:
            DependencyError: tf2_msgs is not installed.
        """
        kind = message_type()
        if kind is None:
            raise DependencyError('guess_frame needs tf2_msgs: apt install ros-jazzy-tf2-msgs')
        self.sensor_frame = ''
        self.state = 'waiting for two clouds'
        self._frame, self._is_own = guess_frame, is_own
        self._poses: dict[str, deque[_Pose]] = {}
        self._changed = threading.Condition()
        self._static = StaticListener(node)
        self._subscription = node.create_subscription(
            kind, GUESS_TF.name, self._on_message, profile(True, GUESS_TF.depth)
        )

    def _on_message(self, msg: Any) -> None:
        with self._changed:
            for item in msg.transforms:
                t, q = item.transform.translation, item.transform.rotation
                turn = np.array([q.x, q.y, q.z, q.w])
                parent = item.header.frame_id.lstrip('/')
                child = item.child_frame_id.lstrip('/')
                if self._is_own(parent, child) or not 0.9 < np.linalg.norm(turn) < 1.1:
                    continue
                T = se3.transform(rotation(turn), np.array([t.x, t.y, t.z]))
                poses = self._poses.setdefault(child, deque(maxlen=_KEPT))
                stamp = to_ns(item.header.stamp)
                if poses and (stamp <= poses[-1].stamp or parent != poses[-1].parent):
                    if stamp == poses[-1].stamp:
                        continue
                    poses.clear()  # another time base or another parent
                poses.append(_Pose(stamp, parent, T))
            self._changed.notify_all()

    def __call__(self, since: int, until: int, steady: F64) -> F64:
        """Motion (4, 4) of the sensor between two instants, ns; `steady` where it is not known."""
        with self._changed:
            self._changed.wait_for(lambda: self._pose(until) is not None, _WAIT_S)
            before, after = self._pose(since), self._pose(until)
        if before is None or after is None:
            self.state = f'no transform from {self._frame} to {self.sensor_frame} at the time'
            return steady
        self.state = 'used'
        T: F64 = se3.inverse(before) @ after
        return T

    def _pose(self, stamp: int) -> F64 | None:
        """Pose (4, 4) of the sensor in the guess frame, or None when it is not known."""
        for child in tuple(self._poses):
            T_child_sensor = self._static.lookup(child, self.sensor_frame)
            if T_child_sensor is None:
                continue
            T_parent_child, parent = self._at(child, stamp)
            if T_parent_child is None:
                continue
            T_frame_parent = self._static.lookup(self._frame, parent)
            if T_frame_parent is not None:
                T: F64 = T_frame_parent @ T_parent_child @ T_child_sensor
                return T
        return None

    def _at(self, child: str, stamp: int) -> tuple[F64 | None, str]:
        """Pose of a moving frame in its parent, interpolated, and the parent."""
        poses = self._poses[child]
        k = bisect.bisect_left(poses, stamp, key=lambda pose: pose.stamp)
        if k == len(poses) or (k == 0 and poses[0].stamp != stamp):
            return None, ''
        after = poses[k]
        if after.stamp == stamp:
            return after.T_parent_child, after.parent
        before = poses[k - 1]
        if after.stamp - before.stamp > _GAP_NS:
            return None, ''
        share = (stamp - before.stamp) / (after.stamp - before.stamp)
        step = se3.log(se3.inverse(before.T_parent_child) @ after.T_parent_child)
        return before.T_parent_child @ se3.exp(share * step), after.parent
