# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Outputs: every publisher of the node, and what one result becomes on each of them."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import PointCloudError
from hybridreg_ros.core.pointcloud2 import from_arrays, with_field
from hybridreg_ros.odometry.result import Source
from hybridreg_ros.ros import topics
from hybridreg_ros.ros.conversions import to_odometry, to_pointcloud2, to_time, to_transform
from hybridreg_ros.ros.diagnostics import of_frame
from hybridreg_ros.ros.qos import profile, publisher_events
from hybridreg_ros.ros.transforms import MISSING, Broadcaster, levelled, pose_matrix

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from rclpy.node import Node

    from hybridreg_ros.odometry.result import OdometryResult
    from hybridreg_ros.ros.extrinsic import Extrinsic
    from hybridreg_ros.ros.node_config import NodeConfig

PROBABILITY = 'dynamic_probability'
_OFFER = 'it is offered reliable, volatile'


class Outputs:
    """Publishes results; called from the threads of the worker, except `configure` and `close`.

    Attributes:
        tf_available: whether tf2_msgs is there.
    """

    def __init__(
        self,
        node: Node,
        config: NodeConfig,
        threshold: float,
        extrinsic: Extrinsic,
        up: Callable[[int], NDArray[np.float64] | None],
    ) -> None:
        """Create the publishers.

        Args:
            node: owner of the publishers.
            config: see `configure`.
            threshold: see `configure`.
            extrinsic: pose of the sensor in the base.
            up: asked at the first pose, with its stamp (ns): (3,) away from gravity, sensor frame.
        """
        self._node = node
        self._tf = Broadcaster(node)
        self.tf_available = self._tf.available
        self._extrinsic = extrinsic
        self._find_up = up
        self._up: NDArray[np.float64] | None = None
        self._begun = False
        self._odometry = self._publisher(Odometry, topics.ODOM)
        self._dynamic = self._publisher(PointCloud2, topics.DYNAMIC_POINTS)
        self._static = self._publisher(PointCloud2, topics.STATIC_POINTS)
        self._keyframe = self._publisher(PointCloud2, topics.KEYFRAME)
        self._path = self._publisher(Path, topics.PATH)
        self._map = self._publisher(PointCloud2, topics.LOCAL_MAP)
        self._map_due_s = 0.0
        self._start = pose_matrix(config.initial_pose)
        self._T_odom_map = self._start
        self._frame = self._publisher(DiagnosticArray, topics.FRAME)
        self._lock = threading.Lock()
        self._sending_pose, self._sending_clouds = threading.Lock(), threading.Lock()
        self._closed = False
        self._poses: deque[PoseStamped] = deque(maxlen=config.path_length)
        self.configure(config, threshold)

    def _publisher(self, kind: type, topic: topics.Topic) -> Any:
        name = self._node.resolve_topic_name(topic.name)
        return self._node.create_publisher(
            kind,
            topic.name,
            profile(reliable=True, depth=topic.depth),
            event_callbacks=publisher_events(self._node, name, _OFFER),
        )

    def configure(self, config: NodeConfig, threshold: float) -> None:
        """Take changed parameters over.

        Args:
            config: frames and switches.
            threshold: points from this P(dynamic) on go to the dynamic cloud.
        """
        with self._lock:
            self._poses = deque(self._poses, maxlen=config.path_length)
        self._config = config
        self._threshold = threshold
        if config.publish_tf and not self.tf_available:
            self._node.get_logger().warning('/tf: ' + self.tf_state, once=True)

    @property
    def twins(self) -> int:
        """Other publishers of this node's odometry: nodes of the same name."""
        return max(int(self._node.count_publishers(self._odometry.topic_name)) - 1, 0)

    @property
    def tf_state(self) -> str:
        """One line about /tf for the diagnostics."""
        if not self._config.publish_tf:
            return 'off'
        return 'on' if self.tf_available else MISSING

    def restart(self, T_odom_start: NDArray[np.float64]) -> None:
        """Begin anew after a reset: no path, the sensor's pose in the base is taken again.

        Args:
            T_odom_start: (4, 4) pose of the base at the first scan.
        """
        with self._lock:
            self._poses.clear()
        self._extrinsic.forget()
        self._start, self._begun = T_odom_start, False

    def open(self) -> None:
        """Publish again."""
        self._closed = False

    def close(self) -> None:
        """Publish nothing any more; a publication in work ends first."""
        with self._sending_pose, self._sending_clouds:
            self._closed = True

    def publish(self, msg: PointCloud2, result: OdometryResult) -> None:
        """Publish the clouds of a result and what became of it, to those who listen."""
        with self._sending_clouds:
            if not self._closed:
                self._publish(msg, result)

    def _publish(self, msg: PointCloud2, result: OdometryResult) -> None:
        config = self._config
        if self._frame.get_subscription_count():
            name = f'{self._node.get_fully_qualified_name().lstrip("/")}: frame'
            self._frame.publish(of_frame(result, name, msg.header.stamp))
        dynamic = result.dynamic_probability >= self._threshold
        self._publish_cloud(self._dynamic, msg, result, dynamic)
        self._publish_cloud(self._static, msg, result, ~dynamic & result.mask_known)
        if config.publish_keyframe and result.is_keyframe:
            self._publish_cloud(self._keyframe, msg, result, ~dynamic)

    def publish_odometry(self, result: OdometryResult) -> None:
        """Publish pose, transform and path: at once, the clouds follow."""
        with self._sending_pose:
            if not self._closed:
                self._publish_odometry(result)

    def _publish_odometry(self, result: OdometryResult) -> None:
        config = self._config
        sensor_frame = result.scan.frame_id.lstrip('/')
        child = config.base_frame or sensor_frame
        T_base_sensor = self._extrinsic.of(sensor_frame)
        if not self._begun and result.source is not Source.LOST:
            self._begun, self._up = True, self._find_up(result.stamp) if config.level else None
        if T_base_sensor is None:
            return
        if self._up is not None:
            self._start, self._up = levelled(self._start, T_base_sensor[:3, :3] @ self._up), None
        frames = config.odom_frame, child
        msg = to_odometry(result, frames, T_base_sensor, self._start, config.planar)
        self._T_odom_map = self._start @ T_base_sensor
        self._odometry.publish(msg)
        if config.publish_tf and result.source is not Source.LOST and child:
            self._tf.send(to_transform(msg, config.invert_tf))
        if config.publish_path and result.source is not Source.LOST:
            with self._lock:
                self._poses.append(PoseStamped(header=msg.header, pose=msg.pose.pose))
                poses = list(self._poses)
            if self._path.get_subscription_count():
                self._path.publish(Path(header=msg.header, poses=poses))

    def publish_map(
        self, map_points: Callable[[], NDArray[np.float32]], result: OdometryResult
    ) -> None:
        """Publish the local map when it is due and someone listens.

        Args:
            map_points: gives (N, 3) float32, frame of the front end.
            result: of the cloud that the map has just taken in.
        """
        now_s = time.monotonic()
        if now_s < self._map_due_s or not self._map.get_subscription_count():
            return
        self._map_due_s = now_s + self._config.local_map_period_s
        header = Header(stamp=to_time(result.stamp), frame_id=self._config.odom_frame)
        msg = to_pointcloud2(from_arrays(self.in_odom(map_points())), header)
        with self._sending_clouds:
            if not self._closed:
                self._map.publish(msg)

    def in_odom(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Points (N, 3) of the map in the odom frame."""
        return se3.apply(self._T_odom_map, points.astype(np.float64)).astype(np.float32)

    def _publish_cloud(
        self, publisher: Any, msg: PointCloud2, result: OdometryResult, keep: NDArray[np.bool_]
    ) -> None:
        if not publisher.get_subscription_count():
            return
        try:
            cloud = with_field(msg, result.scan, PROBABILITY, result.dynamic_probability, keep)
        except PointCloudError as error:
            self._node.get_logger().warning(
                f'{publisher.topic_name} not published: {error}', throttle_duration_sec=10.0
            )
            return
        publisher.publish(to_pointcloud2(cloud, msg.header))
