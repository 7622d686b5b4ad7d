# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A small bag for the tests that play one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from pathlib import Path

FRAMES = 12
STEP_NS = 100_000_000
START_NS = 1_000_000_000_000
NO_TRANSFORMS = bytes([0, 1, 0, 0, 0, 0, 0, 0])  # CDR, little endian, empty sequence


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """mcap bag: 12 clouds at 10 Hz on /lidar/points and their true poses on /ground_truth/odom."""
    from ros_harness import FRAME, room

    from hybridreg_ros.core.pointcloud2 import from_arrays
    from hybridreg_ros.replay.bag_writer import BagWriter

    path = tmp_path_factory.mktemp('bag') / 'room.mcap'
    with BagWriter(path) as writer:
        for k in range(FRAMES):
            stamp, pose = START_NS + k * STEP_NS, np.eye(4)
            pose[0, 3] = 0.05 * k
            data = from_arrays(room(0.05 * k))
            writer.write_cloud('/lidar/points', stamp, FRAME, data)
            if k == 0:
                writer.write_raw('/tf_static', 'tf2_msgs/msg/TFMessage', stamp, NO_TRANSFORMS)
            writer.write_odometry('/ground_truth/odom', stamp, ('world', FRAME), pose)
    return path
