# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The front end that the node builds is the one that runs offline."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from hybridreg_ros import HybridReg
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros.front_end import build_front_end


def test_warm_up_leaves_no_trace_in_the_network() -> None:
    fresh, warm = HybridReg.from_pretrained(), build_front_end(OdometryConfig(), '')
    assert warm.has_weights
    assert set(vars(warm.odometry._registrar)) == set(vars(fresh))
    cloud = np.random.default_rng(0).uniform(-3.0, 3.0, (3000, 3)).astype(np.float32)
    models: list[Any] = [fresh, warm.odometry._registrar]
    voxels_m = [m.sequence().encode(cloud).voxel_size_m for m in models]
    assert voxels_m[0] == voxels_m[1]
