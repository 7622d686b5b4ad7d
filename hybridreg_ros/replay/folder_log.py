# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Folders of recorded files read as bags are, and parts of either."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.core.errors import BagError, HybridRegError
from hybridreg_ros.core.pointcloud2 import MOST_POINTS, to_scan
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.replay import bag_reader
from hybridreg_ros.replay.bag_sources import METADATA, SUFFIXES, BagTopic
from hybridreg_ros.replay.convert import ConvertOptions, kind_of, open_recording
from hybridreg_ros.replay.recording import CLOUD_TOPIC, as_message

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from hybridreg_ros.metrics.trajectory import Trajectory
    from hybridreg_ros.replay.bag_reader import CloudFrame


class FolderLog:
    """A folder of scans or depth images as a bag with the topics that `convert` would write.

    Args:
        path: the folder.
        kind: its layout, see `convert.kind_of`.

    Attributes:
        path: the folder.
        kind: its layout.
        topics: as of a bag.
        recovered: None, nothing is ever cut off.

    Raises:
        FileFormatError: the folder lacks something.
    """

    def __init__(self, path: Path, kind: str) -> None:
        self.path, self.kind = path, kind
        self._recording = open_recording(kind, path, ConvertOptions())
        frames, poses = self._recording.frames, self._recording.poses
        self.topics = {CLOUD_TOPIC: BagTopic(CLOUD_TOPIC, bag_reader.POINT_CLOUD2, frames)}
        if poses:
            name = bag_reader.GROUND_TRUTH_TOPIC
            self.topics[name] = BagTopic(name, bag_reader.ODOMETRY, poses)
        self.recovered: int | None = None

    def __enter__(self) -> FolderLog:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing stays open."""

    def cloud_topic(self, wanted: str | None = None) -> str:
        """Name of the topic of the clouds.

        Raises:
            BagError: another one was asked for.
        """
        if wanted is not None and wanted.strip('/') != CLOUD_TOPIC.strip('/'):
            raise BagError(f'{self.path} is a folder of files ({self.kind}), it has no topics')
        return CLOUD_TOPIC

    def ground_truth(self, topic: str | None = None) -> Trajectory | None:
        """True poses of the folder; None when it has none.

        Raises:
            BagError: a topic was asked for.
        """
        if topic is not None and topic != bag_reader.GROUND_TRUTH_TOPIC:
            raise BagError(f'{self.path} is a folder of files ({self.kind}), it has no topics')
        truth = self._recording.truth
        return bag_reader.trajectory_of(truth) if truth else None

    def frames(
        self, topic: str | None = None, time_unit: str = 'auto', time_field: str = ''
    ) -> Iterator[CloudFrame]:
        """Clouds in their order, unusable ones included with their reason."""
        for number in range(self._recording.frames):
            stamp, message = 0, None
            try:
                frame = self._recording.read(number)
                stamp, message = frame.stamp, as_message(frame)
                scan = to_scan(message, time_unit, time_field=time_field, max_points=MOST_POINTS)
                yield bag_reader.CloudFrame(stamp, message, scan, '')
            except HybridRegError as error:
                yield bag_reader.CloudFrame(stamp, message, None, str(error))


Log = bag_reader.Bag | FolderLog


def open_log(path: Path) -> Log:
    """A bag, or a folder of recorded files.

    Raises:
        BagError: neither, or a bag that cannot be read.
        FileFormatError: a folder that lacks something.
    """
    bag = not path.is_dir() or (path / METADATA).exists()
    if bag or any(p.suffix in (*SUFFIXES, '.bag') for p in path.iterdir()):
        return bag_reader.open_bag(path)
    kind = kind_of(path)
    return bag_reader.open_bag(path) if kind is None else FolderLog(path, kind)


def between(
    frames: Iterator[CloudFrame], start_s: float, duration_s: float | None
) -> Iterator[CloudFrame]:
    """Clouds of a part of a log.

    Args:
        frames: all of them, in stamp order.
        start_s: seconds after the first one.
        duration_s: seconds after that; None for all.
    """
    first: int | None = None
    for frame in frames:
        first = frame.stamp if first is None else first
        at = (frame.stamp - first) / NS_PER_S - start_s
        if duration_s is not None and at > duration_s:
            return
        if at >= 0.0:
            yield frame
