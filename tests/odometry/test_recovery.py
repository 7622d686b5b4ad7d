# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""After a blackout the old map is found again, by the packaged network, or nothing is claimed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny_world import lidar_rays, scans, walk

from hybridreg_ros.benchmark.suite_data import load
from hybridreg_ros.benchmark.suite_list import chosen
from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.odometry.frontend import HybridOdometry

if TYPE_CHECKING:
    from pathlib import Path

    from hybridreg_ros.benchmark.suite_data import SuiteFrame

_DARK = slice(12, 24)
_SOON = 5


@pytest.fixture(scope='module')
def frames(tmp_path_factory: pytest.TempPathFactory) -> list[SuiteFrame]:
    """A walk through a room of which 30 to 50 % moves."""
    (sequence,) = chosen('dev', ['dev-room-502'], frames=36)
    cache: Path = tmp_path_factory.mktemp('frames')
    return load(sequence, cache, cache)


def _wall(scan: Scan) -> Scan:
    """The same scan with the sensor covered: a flat wall at 0.3 m."""
    side = np.linspace(-0.3, 0.3, 150, dtype=np.float32)
    x, y = np.meshgrid(side, side)
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.3, np.float32)], axis=1)
    return Scan(points, stamp=scan.stamp, frame_id=scan.frame_id)


def _empty(scan: Scan) -> Scan:
    return Scan(np.zeros((0, 3), np.float32), stamp=scan.stamp, frame_id=scan.frame_id)


@pytest.mark.parametrize('dark', [_wall, _empty, None], ids=['wall', 'empty', 'silence'])
def test_the_old_map_is_found_again_after_a_blackout(frames: list[SuiteFrame], dark) -> None:
    odometry, start = HybridOdometry(), se3.inverse(frames[0].T_world_sensor)
    right = []
    for k, frame in enumerate(frames):
        scan = frame.scan
        if _DARK.start <= k < _DARK.stop:
            if dark is not None:
                result = odometry.step(dark(scan))
                assert result.confidence < 0.7
            continue
        result = odometry.step(scan)
        off = se3.inverse(start @ frame.T_world_sensor) @ result.pose
        right.append(np.linalg.norm(off[:3, 3]) < 0.05 and se3.rotation_angle_deg(off) < 1.0)
        assert right[-1] or result.confidence < 0.7
    assert all(right[: _DARK.start])
    assert all(right[_DARK.start + _SOON :])


def test_a_pause_is_no_error_of_the_clock() -> None:
    way = walk(8)
    clouds = scans(way, lidar_rays())
    late = [replace(scan, stamp=scan.stamp + 20 * NS_PER_S) for scan in clouds[5:]]
    odometry = HybridOdometry()
    results = [odometry.step(scan) for scan in clouds[:5] + late]
    assert all(result.accepted for result in results)
    assert results[-1].confidence > 0.9
    off = se3.inverse(se3.inverse(way[0]) @ way[-1]) @ results[-1].pose
    assert np.linalg.norm(off[:3, 3]) < 0.03
