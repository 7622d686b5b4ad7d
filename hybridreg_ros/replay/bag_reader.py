# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bags as scans: finds the cloud topic, orders by header stamp, survives a cut-off file."""

from __future__ import annotations

import heapq
import logging
import struct
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import BagError, PointCloudError
from hybridreg_ros.core.pointcloud2 import MOST_POINTS, to_scan
from hybridreg_ros.core.quaternion import from_quaternion
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.metrics.trajectory import Trajectory
from hybridreg_ros.replay.bag_sources import DAMAGE, BagTopic, RawMessage, open_source

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator
    from types import TracebackType

    from hybridreg_ros.core.scan import Scan

logger = logging.getLogger(__name__)

POINT_CLOUD2 = 'sensor_msgs/msg/PointCloud2'
ODOMETRY = 'nav_msgs/msg/Odometry'
POSE_STAMPED = 'geometry_msgs/msg/PoseStamped'
GROUND_TRUTH_TOPIC = '/ground_truth/odom'
REORDER_WINDOW = 8


class BagMessage(NamedTuple):
    """One message: topic, type, log time (ns), header stamp (ns; log time if none), CDR bytes."""

    topic: str
    msgtype: str
    log_time: int
    stamp: int
    raw: bytes


class CloudFrame(NamedTuple):
    """One cloud of a bag: its stamp (ns), and message and scan, or why there is none."""

    stamp: int
    message: Any
    scan: Scan | None
    error: str


class Bag:
    """An opened bag; use it as a context manager.

    Attributes:
        path: file or directory.
        topics: topic name to BagTopic(name, msgtype, messages).
        recovered: messages rescued from a cut-off mcap, None for a whole bag.
    """

    def __init__(self, path: str | Path) -> None:
        """Open a bag.

        Raises:
            BagError: missing, not a bag, or damaged beyond repair.
        """
        self.path = Path(path)
        self._source = open_source(self.path)
        self.topics: dict[str, BagTopic] = self._source.topics
        self.recovered = self._source.recovered
        if self.recovered is not None:
            logger.warning(
                'bag %s is cut off: recovered %d messages by streaming', path, self.recovered
            )

    def __enter__(self) -> Bag:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the file."""
        self._source.close()

    def cloud_topic(self, wanted: str | None = None) -> str:
        """Name of the PointCloud2 topic.

        Args:
            wanted: topic asked for; None accepts the only one there is.

        Raises:
            BagError: no such topic, none, or several to choose from.
        """
        clouds = sorted(t.name for t in self.topics.values() if t.msgtype == POINT_CLOUD2)
        if wanted is not None:
            return self._named(wanted, (POINT_CLOUD2,))
        if not clouds:
            raise BagError(f'{self.path} has no PointCloud2 topic; found: {self._listing()}')
        if len(clouds) > 1:
            raise BagError(
                f'{self.path} has {len(clouds)} PointCloud2 topics, choose one with --topic: '
                f'{", ".join(clouds)}'
            )
        return clouds[0]

    def _named(self, wanted: str, msgtypes: tuple[str, ...]) -> str:
        topic = self.topics.get(wanted) or self.topics.get(f'/{wanted}')
        if topic is None:
            raise BagError(f'{self.path} has no topic {wanted}; found: {self._listing()}')
        if topic.msgtype not in msgtypes:
            raise BagError(
                f'topic {wanted} of {self.path} is {topic.msgtype}, expected {msgtypes[0]}'
            )
        return topic.name

    def _listing(self) -> str:
        return ', '.join(f'{t.name} ({t.msgtype})' for t in self.topics.values()) or 'no topic'

    def messages(
        self, topics: Collection[str] | None = None, window: int = REORDER_WINDOW
    ) -> Iterator[BagMessage]:
        """Messages in the order of their header stamps.

        Args:
            topics: topic names; None takes all.
            window: messages held back to put late ones in their place; memory is bounded by it.

        Raises:
            BagError: the file is damaged at the place reached.
        """
        names = self.topics.keys() if topics is None else topics
        held: list[tuple[int, int, BagMessage]] = []
        for number, stored in enumerate(self._source.read(names)):
            message = BagMessage(
                stored.topic, stored.msgtype, stored.log_time, self._stamp(stored), stored.raw
            )
            heapq.heappush(held, (message.stamp, number, message))
            if len(held) > window:
                yield heapq.heappop(held)[2]
        while held:
            yield heapq.heappop(held)[2]

    def _stamp(self, message: RawMessage) -> int:
        """Header stamp read from the CDR bytes; the log time for types without a header."""
        fields = self._source.typestore.fielddefs.get(message.msgtype, ((), ()))[1]
        if not fields or fields[0][0] != 'header' or len(message.raw) < 12:
            return message.log_time
        order = '<' if message.raw[1] & 1 else '>'
        sec, nanosec = struct.unpack_from(f'{order}iI', message.raw, 4)
        return int(sec) * NS_PER_S + int(nanosec)

    def decode(self, message: BagMessage) -> Any:
        """Message object with the attributes of its ROS type; arrays are numpy.

        Raises:
            BagError: the bytes do not fit the type.
        """
        try:
            return self._source.typestore.deserialize_cdr(message.raw, message.msgtype)
        except DAMAGE as error:
            raise BagError(
                f'message at {message.stamp / NS_PER_S:.6f} s on {message.topic} cannot be '
                f'decoded: {" ".join(str(error).split())}'
            ) from None

    def frames(self, topic: str | None = None, time_unit: str = 'auto') -> Iterator[CloudFrame]:
        """Clouds in stamp order, unusable ones included with their reason; thinned as live.

        Args:
            topic: PointCloud2 topic; None takes the only one.
            time_unit: unit of per-point times, see core.pointcloud2.to_scan.
        """
        for message in self.messages([self.cloud_topic(topic)]):
            cloud: Any = None
            try:
                cloud = self.decode(message)
                scan = to_scan(cloud, time_unit=time_unit, max_points=MOST_POINTS)
                yield CloudFrame(message.stamp, cloud, scan, '')
            except (BagError, PointCloudError) as error:
                yield CloudFrame(message.stamp, cloud, None, str(error))

    def scans(self, topic: str | None = None, time_unit: str = 'auto') -> Iterator[Scan]:
        """Scans in stamp order; unusable clouds are logged and left out."""
        for frame in self.frames(topic, time_unit):
            if frame.scan is None:
                logger.warning('cloud at %.6f s dropped: %s', frame.stamp / NS_PER_S, frame.error)
            else:
                yield frame.scan

    def trajectory(self, topic: str) -> Trajectory:
        """Poses of an Odometry or PoseStamped topic; of equal stamps the last one counts.

        Raises:
            BagError: no such topic, or another type.
        """
        name = self._named(topic, (ODOMETRY, POSE_STAMPED))
        poses: dict[int, Any] = {}
        for message in self.messages([name]):
            decoded = self.decode(message)
            pose = decoded.pose.pose if message.msgtype == ODOMETRY else decoded.pose
            poses[message.stamp] = _matrix(pose)
        return trajectory_of(poses.items())

    def ground_truth(self, topic: str | None = None) -> Trajectory | None:
        """True poses: of the topic asked for, or of /ground_truth/odom; None when absent."""
        if topic is not None:
            return self.trajectory(topic)
        return self.trajectory(GROUND_TRUTH_TOPIC) if GROUND_TRUTH_TOPIC in self.topics else None


def trajectory_of(poses: Iterable[tuple[int, Any]]) -> Trajectory:
    """Trajectory of (stamp in ns, (4, 4) pose) pairs in any order."""
    ordered = sorted(poses, key=lambda item: item[0])
    matrices = [T for _, T in ordered]
    return Trajectory(
        np.array([stamp for stamp, _ in ordered], dtype=np.int64),
        np.array(matrices, dtype=np.float64).reshape(-1, 4, 4),
    )


def _matrix(pose: Any) -> Any:
    q, p = pose.orientation, pose.position
    return se3.transform(from_quaternion(q.x, q.y, q.z, q.w), np.array([p.x, p.y, p.z]))


def group_by_stamp(
    bag: Bag, topics: Collection[str]
) -> Iterator[tuple[int, dict[str, BagMessage]]]:
    """Messages of several topics that share a header stamp, in stamp order."""
    groups: dict[int, dict[str, BagMessage]] = defaultdict(dict)
    for message in bag.messages(topics):
        groups[message.stamp][message.topic] = message
        while len(groups) > REORDER_WINDOW:
            first = min(groups)
            yield first, groups.pop(first)
    for stamp in sorted(groups):
        yield stamp, groups[stamp]


def open_bag(path: str | Path) -> Bag:
    """Open a rosbag2 file or directory for reading.

    Raises:
        BagError: missing, not a bag, or damaged beyond repair.
    """
    return Bag(path)
