# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""SecondSensor: each cloud of the first sensor is joined by the nearest in time of the second."""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import PointCloudError
from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.ros.clouds.subscription import CloudSubscription
from hybridreg_ros.ros.conversions import to_ns, to_pointcloud2
from hybridreg_ros.ros.topics import POINTS_2
from hybridreg_ros.ros.transforms import StaticListener

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from rclpy.node import Node
    from sensor_msgs.msg import PointCloud2

    from hybridreg_ros.ros.node_config import NodeConfig

_KEPT = 8


class SecondSensor:
    """Clouds of `points_2`, brought into frame and time of those of `points`.

    Attributes:
        state: 'used', or why clouds of the first sensor are taken alone.
    """

    def __init__(
        self,
        node: Node,
        config: NodeConfig,
        decode: Callable[[PointCloud2], Scan],
    ) -> None:
        """Subscribe to /tf_static.

        Args:
            node: owner of the subscriptions.
            config: how far apart in time two clouds may be.
            decode: makes a scan of a cloud, as for the first sensor.

        Raises:
            DependencyError: tf2_msgs is not installed.
        """
        self.state = 'waiting for two clouds'
        self._decode = decode
        self._node, self._within_s = node, config.pair_within_s
        self._clouds: deque[PointCloud2] = deque(maxlen=_KEPT)
        self._fresh = False
        self._changed = threading.Condition()
        self._static = StaticListener(node)

    def open(self, qos: str, depth: int, on_lost: Callable[[int], None]) -> CloudSubscription:
        """Subscribe to `points_2`; arguments as for the first sensor."""
        return CloudSubscription(self._node, (POINTS_2.name, qos, depth), self._on_cloud, on_lost)

    def _on_cloud(self, msg: PointCloud2) -> None:
        with self._changed:
            self._clouds.append(msg)
            self._fresh = True
            self._changed.notify_all()

    def join(self, msg: PointCloud2, scan: Scan) -> tuple[PointCloud2, Scan]:
        """A cloud with the one of the second sensor that belongs to it; else it alone.

        Args:
            msg: of the first sensor.
            scan: it, decoded.
        """
        other = self._partner(scan.stamp)
        if other is None:
            self.state = f'no cloud on {POINTS_2.name} within {self._within_s:g} s'
            return msg, scan
        frame = other.header.frame_id.lstrip('/')
        T_first_second = self._static.lookup(scan.frame_id.lstrip('/'), frame)
        if T_first_second is None:
            self.state = f'no transform from {scan.frame_id} to {frame} on /tf_static'
            return msg, scan
        try:
            second = self._decode(other)
        except PointCloudError as error:
            self.state = f'no usable cloud: {error}'
            return msg, scan
        self.state = 'used'
        both = joined(scan, second, T_first_second)
        fields: dict[str, NDArray[np.generic]] = {
            'sensor': np.repeat(np.array([1, 2], np.uint8), [len(scan), len(second)])
        }
        if both.times is not None:
            fields['time'] = both.times
        return to_pointcloud2(from_arrays(both.points, fields), msg.header), both

    def _partner(self, stamp: int) -> PointCloud2 | None:
        """The cloud nearest to a stamp (ns); waits for it while the sensor is alive."""
        with self._changed:
            wait_s = self._within_s if self._fresh else 0.0
            self._fresh = False
            found: PointCloud2 | None = self._changed.wait_for(lambda: self._near(stamp), wait_s)
            while found is not None and self._clouds.popleft() is not found:
                pass  # what is older belongs to clouds that have gone
        return found

    def _near(self, stamp: int) -> PointCloud2 | None:
        def off(msg: PointCloud2) -> int:
            return abs(to_ns(msg.header.stamp) - stamp)

        nearest = min(self._clouds, key=off, default=None)
        if nearest is None or off(nearest) > self._within_s * NS_PER_S:
            return None
        return nearest


def joined(first: Scan, second: Scan, T_first_second: NDArray[np.float64]) -> Scan:
    """Points of two sensors as one scan in frame and time of the first.

    Where stamps differ, each point has its time, so that the motion between both is undone.

    Args:
        first: in its frame.
        second: in its own frame.
        T_first_second: (4, 4) pose of the second sensor in the first frame.
    """
    later_s = (second.stamp - first.stamp) / NS_PER_S
    times = None
    if later_s or first.times is not None or second.times is not None:
        of_each = [np.zeros(len(s)) if s.times is None else s.times for s in (first, second)]
        times = np.concatenate([of_each[0], of_each[1] + later_s])
    names = dict.fromkeys((first.times_from, second.times_from))
    there = se3.apply(T_first_second, second.points.astype(np.float64))
    return Scan(
        np.concatenate([first.points, there.astype(np.float32)]),
        times,
        first.stamp,
        first.frame_id,
        notes=(*first.notes, *(f'points_2: {note}' for note in second.notes)),
        near=first.near + second.near,
        times_from=' and '.join(name for name in names if name),
    )
