# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Writes tiny bags for the tests of replay, cli and ros."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.pointcloud2 import CloudData, from_arrays
from hybridreg_ros.replay.bag_writer import BagWriter
from hybridreg_ros.replay.trajectory_io import tum_row

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from hybridreg_ros.metrics.trajectory import Trajectory

START = 1_700_000_000_123_456_789
PERIOD = 100_000_000


def room_points(rng: np.random.Generator, n: int = 3000) -> NDArray[np.float32]:
    """Points on the walls, floor and two pillars of a 8 x 6 x 3 m room, world frame, metres."""
    walls = rng.random((n, 3)) * [8.0, 6.0, 3.0] - [4.0, 3.0, 1.0]
    side = rng.integers(0, 5, n)
    walls[side == 0, 0] = -4.0
    walls[side == 1, 0] = 4.0
    walls[side == 2, 1] = -3.0
    walls[side == 3, 1] = 3.0
    walls[side == 4, 2] = -1.0
    angle = rng.random(n // 4) * 2 * np.pi
    pillar = np.stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), rng.random(n // 4) * 3 - 1], 1)
    pillar[::2] += [2.0, 1.5, 0.0]
    pillar[1::2] += [-2.5, -1.0, 0.0]
    return np.concatenate([walls, pillar]).astype(np.float32)


def sensor_pose(i: int) -> NDArray[np.float64]:
    """T_world_sensor of frame i: walks forward and turns slowly."""
    return se3.exp(np.array([0.06 * i, 0.02 * i, 0.0, 0.0, 0.0, 0.02 * i]))


def room_cloud(i: int, n: int = 3000) -> CloudData:
    """Cloud of frame i in the sensor frame: static room (label 0) and a moving box (label 1)."""
    rng = np.random.default_rng(i)
    static = room_points(rng, n)
    box = (rng.random((n // 10, 3)) * [0.4, 0.4, 1.5]).astype(np.float32)
    box += np.array([1.0 - 0.15 * i, -1.5, -1.0], dtype=np.float32)
    world = np.concatenate([static, box])
    points = se3.apply(se3.inverse(sensor_pose(i)), world).astype(np.float32)
    points += rng.normal(0, 0.003, points.shape).astype(np.float32)
    label = np.repeat(np.array([0, 1], np.uint8), [len(static), len(box)])
    return from_arrays(points, {'intensity': points[:, 2].copy(), 'label': label})


def write_room_bag(
    path: Path,
    frames: int = 12,
    order: list[int] | None = None,
    topics: tuple[str, ...] = ('/points',),
    truth: bool = True,
    n: int = 3000,
) -> None:
    """Write a bag of the room; `order` is the order in which the frames are stored."""
    with BagWriter(path) as bag:
        for i in order or range(frames):
            stamp = START + i * PERIOD
            for topic in topics:
                bag.write_cloud(topic, stamp, 'lidar', room_cloud(i, n))
            if truth:
                bag.write_odometry('/ground_truth/odom', stamp, ('world', 'lidar'), sensor_pose(i))


def write_mcap(
    path: Path,
    messages: Iterable[tuple[str, int, bytes]],
    schema: tuple[str, str, bytes],
    encoding: str = 'cdr',
    chunked: bool = True,
) -> None:
    """Write an mcap file with any message definition, of which the messages need not be.

    Args:
        path: new file.
        messages: topic, log time (ns) and bytes of each.
        schema: name, encoding and text of the only definition.
        encoding: of the messages.
        chunked: False writes a file without chunks, so without an index.
    """
    from mcap.writer import Writer

    with path.open('wb') as stream:
        writer = Writer(stream, use_chunking=chunked)
        writer.start(profile='ros2', library='test')
        kind = writer.register_schema(*schema)
        channels: dict[str, int] = {}
        for topic, stamp, raw in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, encoding, kind)
            writer.add_message(channels[topic], stamp, raw, stamp)
        writer.finish()


def cloud_bytes(frames: int, stamped: bool = True, n: int = 3000) -> list[tuple[str, int, bytes]]:
    """Topic, log time and CDR bytes of clouds of the room; without `stamped`, stamps are zero."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    found = []
    for i in range(frames):
        cloud, stamp = room_cloud(i, n), START + i * PERIOD
        sec, nanosec = divmod(stamp if stamped else 0, 10**9)
        time = types['builtin_interfaces/msg/Time'](sec, nanosec)
        message = types['sensor_msgs/msg/PointCloud2'](
            types['std_msgs/msg/Header'](time, 'lidar'),
            cloud.height,
            cloud.width,
            [types['sensor_msgs/msg/PointField'](*field) for field in cloud.fields],
            cloud.is_bigendian,
            cloud.point_step,
            cloud.row_step,
            cloud.data,
            cloud.is_dense,
        )
        raw = bytes(store.serialize_cdr(message, 'sensor_msgs/msg/PointCloud2'))
        found.append(('/points', stamp, raw))
    return found


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a TUM file, row by row as `hybridreg replay` does."""
    rows = zip(trajectory.stamps, trajectory.poses, strict=True)
    path.write_text(''.join(tum_row(s, T) + '\n' for s, T in rows), encoding='ascii')
