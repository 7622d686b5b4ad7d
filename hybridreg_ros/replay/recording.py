# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Frames of any origin (files, simulation) written as a bag with clouds and true poses."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.pointcloud2 import CloudData, from_arrays
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.replay.bag_reader import GROUND_TRUTH_TOPIC

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from typing import Any

    from numpy.typing import NDArray

    from hybridreg_ros.replay.bag_writer import BagWriter

CLOUD_TOPIC = '/points'
WORLD_FRAME = 'world'
EPOCH_S = 1_000_000_000
"""Stamp of the first frame of a recording without times (a stamp of zero means 'none' in ROS)."""


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """One cloud and, where known, the true pose of its sensor.

    Attributes:
        stamp: ns.
        frame_id: sensor frame.
        cloud: layout and bytes.
        T_world_sensor: (4, 4) at the stamp, metres; None when unknown.
    """

    stamp: int
    frame_id: str
    cloud: CloudData
    T_world_sensor: NDArray[np.float64] | None


def as_message(frame: RecordedFrame) -> SimpleNamespace:
    """A frame with the attributes of a sensor_msgs/PointCloud2."""
    sec, nanosec = divmod(frame.stamp, NS_PER_S)
    header = SimpleNamespace(
        stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id=frame.frame_id
    )
    return SimpleNamespace(header=header, **vars(frame.cloud))


def simulated(
    scene: str, frames: int, rate_hz: float, seed: int, dynamic: str
) -> Iterator[RecordedFrame]:
    """Frames of a procedural sequence, with the fields label, instance and (lidar) t.

    Args:
        scene: room or street.
        frames: number of frames.
        rate_hz: frames per second.
        seed: of everything random.
        dynamic: share of moving points in percent: none, 10-30 or 30-50.

    Raises:
        ConfigError: an argument is outside its range.
    """
    from hybridreg_ros.data.sequences.simulate import simulate

    for frame in simulate(scene, frames, rate_hz, seed, dynamic=dynamic):
        extra: dict[str, NDArray[Any]] = {
            'label': frame.label.astype(np.uint8),
            'instance': frame.instance.astype(np.uint16),
        }
        if frame.times is not None:
            extra['t'] = frame.times.astype(np.float32)
        yield RecordedFrame(
            EPOCH_S * NS_PER_S + round(frame.stamp_s * NS_PER_S),
            frame.frame_id,
            from_arrays(frame.points, extra, frame.shape),
            frame.T_world_sensor,
        )


def write_recording(frames: Iterable[RecordedFrame], bag: BagWriter) -> tuple[int, int]:
    """Write clouds on /points and true poses on /ground_truth/odom.

    Returns:
        Number of clouds and number of poses written.
    """
    clouds = poses = 0
    for frame in frames:
        bag.write_cloud(CLOUD_TOPIC, frame.stamp, frame.frame_id, frame.cloud)
        clouds += 1
        if frame.T_world_sensor is not None:
            bag.write_odometry(
                GROUND_TRUTH_TOPIC,
                frame.stamp,
                (WORLD_FRAME, frame.frame_id),
                frame.T_world_sensor,
            )
            poses += 1
    return clouds, poses
