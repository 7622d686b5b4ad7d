# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""/tf out and the sensor's pose in the base frame in; tf2_msgs is used when it is installed."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import DependencyError
from hybridreg_ros.ros.conversions import rotation
from hybridreg_ros.ros.qos import profile
from hybridreg_ros.ros.topics import TF, TF_STATIC

if TYPE_CHECKING:
    from geometry_msgs.msg import TransformStamped
    from numpy.typing import NDArray
    from rclpy.node import Node

MISSING = (
    'tf2_msgs is not installed: no /tf; apt install ros-jazzy-tf2-msgs, '
    'or scripts/build_tf2_msgs.py in a pip environment'
)


def message_type() -> Any | None:
    """Class tf2_msgs.msg.TFMessage, or None when tf2_msgs is not installed."""
    try:
        return importlib.import_module('tf2_msgs.msg').TFMessage
    except ImportError:
        return None


class Broadcaster:
    """Sends transforms on /tf; does nothing without tf2_msgs.

    Attributes:
        available: whether transforms can be sent.
    """

    def __init__(self, node: Node) -> None:
        self._type = message_type()
        self.available = self._type is not None
        self._publisher = (
            node.create_publisher(self._type, TF.name, profile(reliable=True, depth=TF.depth))
            if self.available
            else None
        )

    def send(self, transform: TransformStamped) -> None:
        """Publish one transform."""
        if self._type is not None and self._publisher is not None:
            self._publisher.publish(self._type(transforms=[transform]))


class StaticListener:
    """Collects /tf_static and finds the pose of one frame in another along it."""

    def __init__(self, node: Node) -> None:
        """Subscribe to /tf_static.

        Raises:
            DependencyError: tf2_msgs is not installed.
        """
        tf_message = message_type()
        if tf_message is None:
            raise DependencyError(
                'base_frame with extrinsic_source tf needs tf2_msgs, which is not installed: '
                'set extrinsic_source to parameter and give extrinsic'
            )
        self._parents: dict[str, tuple[str, NDArray[np.float64]]] = {}
        self._subscription = node.create_subscription(
            tf_message,
            TF_STATIC.name,
            self._on_message,
            profile(True, TF_STATIC.depth, latched=True),
        )

    def _on_message(self, msg: Any) -> None:
        for item in msg.transforms:
            t, q = item.transform.translation, item.transform.rotation
            orientation = np.array([q.x, q.y, q.z, q.w])
            if not 0.9 < np.linalg.norm(orientation) < 1.1:
                continue
            T = se3.transform(rotation(orientation), np.array([t.x, t.y, t.z]))
            child, parent = (
                name.lstrip('/') for name in (item.child_frame_id, item.header.frame_id)
            )
            self._parents = {**self._parents, child: (parent, T)}

    def lookup(self, target: str, source: str) -> NDArray[np.float64] | None:
        """Pose (4, 4) T_target_source of `source` in `target`, or None when not connected."""
        parents = self._parents
        up_source, up_target = _chain(parents, source), _chain(parents, target)
        common = next((frame for frame in up_source if frame in up_target), None)
        if common is None:
            return None
        T: NDArray[np.float64] = se3.inverse(up_target[common]) @ up_source[common]
        return T


def _chain(
    parents: dict[str, tuple[str, NDArray[np.float64]]], frame: str
) -> dict[str, NDArray[np.float64]]:
    """Every ancestor of a frame (itself first) with T_ancestor_frame."""
    chain = {frame: np.eye(4)}
    while frame in parents:
        parent, T_parent_frame = parents[frame]
        if parent in chain:
            break
        chain[parent] = T_parent_frame @ chain[frame]
        frame = parent
    return chain


def levelled(T: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """A pose (4, 4) of the base with its own position and yaw, and roll and pitch by gravity.

    Args:
        T: (4, 4) pose of the base.
        up: (3,) away from gravity, base axes.
    """
    yaw = np.arctan2(T[1, 0], T[0, 0])
    z = up / np.linalg.norm(up)
    ahead = np.array([1.0, 0.0, 0.0]) - z[0] * z  # x axis of the base in the horizontal
    if np.linalg.norm(ahead) < 1e-3:  # it points up or down: there is no yaw
        ahead = np.array([0.0, 0.0, -np.sign(z[0])])
    x = ahead / np.linalg.norm(ahead)
    R_level_base = np.stack([x, np.cross(z, x), z])
    return se3.transform(se3.so3_exp(np.array([0.0, 0.0, yaw])) @ R_level_base, T[:3, 3])


def pose_matrix(values: tuple[float, ...]) -> NDArray[np.float64]:
    """Transform (4, 4) of x y z qx qy qz qw."""
    return se3.transform(rotation(np.array(values[3:])), np.array(values[:3]))
