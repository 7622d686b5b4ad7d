# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""More registered points make a better pose, but neighbours err alike: they inform less."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny_world import ROOM, cast, depth_rays, pose

import hybridreg_ros.odometry.preprocess as preprocessing
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.map.local_map import LocalMap
from hybridreg_ros.odometry.motion.prediction import Expected
from hybridreg_ros.odometry.preprocess import preprocess, recognise_sensor
from hybridreg_ros.odometry.registration.alignment import align, align_scan

if TYPE_CHECKING:
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan


def test_more_points_of_finer_cubes_do_not_count_as_so_much_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points = cast(ROOM, pose(-1.0, -0.5, 0.0), depth_rays(640, 480))[0]
    config = OdometryConfig()
    sensor = recognise_sensor(points, config)
    scan = Scan(points, stamp=1.0, frame_id='s')

    def prepared() -> PreprocessedScan:
        return preprocess(scan, sensor, config.preprocess, np.zeros(6))

    fine = prepared()
    monkeypatch.setitem(preprocessing._ENOUGH, 'depth', 1)
    coarse = prepared()
    assert coarse.icp_share == 1.0
    assert len(fine.icp_rows) > max(2500, 1.2 * len(coarse.icp_rows))
    independent = max(2500, len(coarse.icp_rows))
    assert fine.icp_share == pytest.approx(independent / len(fine.icp_rows), rel=0.02)
    local_map = LocalMap(sensor.voxel_size_m, 8.0, True)
    local_map.update(fine.means.astype(np.float64), np.zeros(3))
    all_count = align(fine.icp_points, np.eye(4), local_map, basin='fine')
    aligned = align_scan(fine, np.eye(4), local_map)
    np.testing.assert_allclose(aligned.T_odom_sensor, all_count.T_odom_sensor)
    np.testing.assert_allclose(aligned.information, fine.icp_share * all_count.information)
    aside = Expected(pose(0.05, 0.0, 0.0, 0.0), 0.002, 0.01, 0.1)
    drawn = [
        align_scan(one, np.eye(4), local_map, prior=aside).T_odom_sensor[0, 3]
        for one in (replace(fine, icp_share=1.0), fine, replace(fine, icp_share=0.01))
    ]
    assert 0.0 < drawn[0] < drawn[1] < drawn[2]
