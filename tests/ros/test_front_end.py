# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The front end that the node builds is the one that runs offline."""

from __future__ import annotations

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros.front_end import build_front_end


def test_warm_up_does_not_choose_the_voxel_size_of_the_network() -> None:
    front_end = build_front_end(OdometryConfig(), '')
    assert front_end.has_weights
    assert front_end.odometry._registrar.voxel_size_m is None
