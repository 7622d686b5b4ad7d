# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bags as scans: finds the cloud topic, orders by header stamp, survives a cut-off file."""

from __future__ import annotations

import heapq
import logging
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hybridreg_ros.core import pointcloud2, se3
from hybridreg_ros.core.errors import BagError, FileFormatError, PointCloudError
from hybridreg_ros.core.quaternion import from_quaternion
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.metrics.trajectory import Trajectory
from hybridreg_ros.replay.bag_files import DAMAGE, RawMessage, one_line
from hybridreg_ros.replay.bag_sources import BagTopic, open_source

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator
    from types import TracebackType

    from hybridreg_ros.core.scan import Scan

logger = logging.getLogger(__name__)

POINT_CLOUD2 = 'sensor_msgs/msg/PointCloud2'
ODOMETRY = 'nav_msgs/msg/Odometry'
POSE_STAMPED = 'geometry_msgs/msg/PoseStamped'
POSES = (
    ODOMETRY,
    POSE_STAMPED,
    'geometry_msgs/msg/PoseWithCovarianceStamped',
    'geometry_msgs/msg/TransformStamped',
)
"""Message types that hold one stamped pose."""
STAMPED = (POINT_CLOUD2, *POSES)
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
        self._without_stamps: set[str] = set()
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
            wanted: topic asked for; None takes that with most messages, of equals the first.

        Raises:
            BagError: no such topic, none, or one without messages.
        """
        clouds = [t for t in self.topics.values() if t.msgtype == POINT_CLOUD2]
        if wanted is not None:
            name = self._named(wanted, (POINT_CLOUD2,))
        elif clouds:
            name = min(clouds, key=lambda t: (-t.messages, t.name)).name
        else:
            raise BagError(f'{self.path} has no PointCloud2 topic; found: {self._listing()}')
        if not self.topics[name].messages:
            raise BagError(f'{self.path} holds no message on {name}')
        return name

    def _named(self, wanted: str, msgtypes: tuple[str, ...]) -> str:
        topic = self.topics.get(wanted) or self.topics.get(f'/{wanted}')
        if topic is None:
            raise BagError(f'{self.path} has no topic {wanted}; found: {self._listing()}')
        if topic.msgtype not in msgtypes:
            expected = ' or '.join(msgtypes)
            raise BagError(
                f'topic {wanted} of {self.path} is {topic.msgtype}, expected {expected}'
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
            stamp, raw = self._stamp(stored)
            message = BagMessage(stored.topic, stored.msgtype, stored.log_time, stamp, raw)
            heapq.heappush(held, (message.stamp, number, message))
            if len(held) > window:
                yield heapq.heappop(held)[2]
        while held:
            yield heapq.heappop(held)[2]

    def _stamp(self, message: RawMessage) -> tuple[int, bytes]:
        """Header stamp read from the CDR bytes, and the bytes.

        The log time stands in for types without a header, and for a stamp of zero, which means
        'none' in ROS; it is then written into the bytes of clouds and poses.
        """
        raw, log_time = message.raw, message.log_time
        fields = self._source.typestore.fielddefs.get(message.msgtype, ((), ()))[1]
        if not fields or fields[0][0] != 'header' or len(raw) < 12:
            return log_time, raw
        layout = f'{"<" if raw[1] & 1 else ">"}iI'
        sec, nanosec = struct.unpack_from(layout, raw, 4)
        if (sec, nanosec) != (0, 0):
            return int(sec) * NS_PER_S + int(nanosec), raw
        seconds, rest = divmod(log_time, NS_PER_S)
        if message.msgtype not in STAMPED or seconds >= 2**31:
            return log_time, raw
        if message.topic not in self._without_stamps:
            self._without_stamps.add(message.topic)
            logger.warning('stamps of %s are zero: log times stand in', message.topic)
        return log_time, raw[:4] + struct.pack(layout, seconds, rest) + raw[12:]

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
                f'decoded: {one_line(error)}'
            ) from None

    def frames(
        self, topic: str | None = None, time_unit: str = 'auto', time_field: str = ''
    ) -> Iterator[CloudFrame]:
        """Clouds in stamp order, unusable ones included with their reason; thinned as live.

        Args:
            topic: PointCloud2 topic; None as for `cloud_topic`.
            time_unit: unit of per-point times, see core.pointcloud2.to_scan.
            time_field: field of per-point times, '' = by the usual names.
        """
        for message in self.messages([self.cloud_topic(topic)]):
            cloud: Any = None
            try:
                if message.stamp < 0:
                    raise BagError(f'its stamp is negative: {message.stamp / NS_PER_S:.6f} s')
                cloud = self.decode(message)
                scan = pointcloud2.to_scan(
                    cloud,
                    time_unit,
                    time_field=time_field,
                    max_points=pointcloud2.MOST_POINTS,
                )
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
        """Poses of a topic of a type in `POSES`; of equal stamps the last one counts.

        Raises:
            BagError: no such topic, another type, or a message that holds no pose.
        """
        name = self._named(topic, POSES)
        poses: dict[int, Any] = {}
        for message in self.messages([name]):
            try:
                poses[message.stamp] = _matrix(self.decode(message))
            except FileFormatError as error:
                second = message.stamp / NS_PER_S
                raise BagError(f'{self.path}, {name} at {second:.6f} s: {error}') from None
        return trajectory_of(poses.items())

    def ground_truth(self, topic: str | None = None) -> Trajectory | None:
        """True poses: of the topic asked for, or of /ground_truth/odom; None when absent."""
        if topic is not None:
            return self.trajectory(topic)
        usual = self.topics.get(GROUND_TRUTH_TOPIC)
        return self.trajectory(GROUND_TRUTH_TOPIC) if usual and usual.messages else None


def trajectory_of(poses: Iterable[tuple[int, Any]]) -> Trajectory:
    """Trajectory of (stamp in ns, (4, 4) pose) pairs in any order."""
    ordered = sorted(poses, key=lambda item: item[0])
    matrices = [T for _, T in ordered]
    return Trajectory(
        np.array([stamp for stamp, _ in ordered], dtype=np.int64),
        np.array(matrices, dtype=np.float64).reshape(-1, 4, 4),
    )


def _matrix(message: Any) -> Any:
    """Pose (4, 4) of a message of a type in `POSES`.

    Raises:
        FileFormatError: its quaternion has not norm 1, or its place is not finite.
    """
    if hasattr(message, 'transform'):
        q, p = message.transform.rotation, message.transform.translation
    else:
        pose = message.pose.pose if hasattr(message.pose, 'pose') else message.pose
        q, p = pose.orientation, pose.position
    place = np.array([p.x, p.y, p.z])
    if not np.isfinite(place).all():
        raise FileFormatError(f'its place is {place.tolist()}')
    return se3.transform(from_quaternion(q.x, q.y, q.z, q.w), place)


def open_bag(path: str | Path) -> Bag:
    """Open a bag of ROS 2 (file or directory) or ROS 1 (file) for reading.

    Raises:
        BagError: missing, not a bag, or damaged beyond repair.
    """
    return Bag(path)
