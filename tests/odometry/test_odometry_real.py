# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Without a network on real recordings: at least as good as kiss-icp, and sure of itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.benchmark.pipelines import KissIcp
from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.frontend import HybridOdometry

if TYPE_CHECKING:
    from hybridreg_ros.odometry.result import OdometryResult

DATA = Path(__file__).parents[3] / 'shared' / 'data'


def recording(name: str, poses: str, period_s: float, stride: int) -> tuple[list[Scan], list]:
    folder = DATA / name
    if not folder.is_dir():
        pytest.skip(f'{folder} is missing: real recordings are not part of the repository')
    files = sorted((folder / 'velodyne').glob('*.bin'))[::stride]
    rows = np.loadtxt(folder / poses).reshape(-1, 3, 4)[::stride]
    truth = [np.vstack([row, [0.0, 0.0, 0.0, 1.0]]) for row in rows]
    scans = [
        Scan(
            np.fromfile(file, np.float32).reshape(-1, 4)[:, :3],
            stamp=1.0 + k * period_s * stride,
            frame_id='lidar',
        )
        for k, file in enumerate(files)
    ]
    return scans, truth


def step_errors(poses: list, truth: list) -> np.ndarray:
    """(N-1, 2) metres and degrees per step."""
    rows = []
    for k in range(len(poses) - 1):
        moved = se3.inverse(poses[k]) @ poses[k + 1]
        off = se3.inverse(se3.inverse(truth[k]) @ truth[k + 1]) @ moved
        rows.append((np.linalg.norm(off[:3, 3]), se3.rotation_angle_deg(off[:3, :3])))
    return np.array(rows)


def run(scans: list[Scan]) -> list[OdometryResult]:
    odometry = HybridOdometry(OdometryConfig(registrar='kiss-icp'), model=None)
    return [odometry.step(scan) for scan in scans]


@pytest.mark.real_data
@pytest.mark.slow
@pytest.mark.parametrize(
    ('name', 'poses', 'period_s', 'stride', 'mean_m'),
    [
        ('lidar_balm_walk_a', 'poses.txt', 0.5, 1, 0.006),
        ('lidar_balm_walk_a', 'poses.txt', 0.5, 2, 0.008),
        ('lidar_kitti_raw_22scans', 'poses_reference_icp.txt', 0.1, 1, 0.007),
        ('lidar_kitti_raw_22scans', 'poses_reference_icp.txt', 0.1, 5, 0.015),
        ('lidar_kitti07_keyframes5', 'poses.txt', 1.0, 1, 0.035),
    ],
)
def test_every_step_is_right(
    name: str, poses: str, period_s: float, stride: int, mean_m: float
) -> None:
    scans, truth = recording(name, poses, period_s, stride)
    results = run(scans)
    errors = step_errors([r.pose for r in results], truth)
    assert errors[:, 0].mean() < mean_m
    assert errors[:, 0].max() < 0.2
    assert errors[:, 1].max() < 1.0
    assert min(r.confidence for r in results) > 0.5


@pytest.mark.real_data
@pytest.mark.slow
def test_steps_are_better_than_those_of_kiss_icp() -> None:
    scans, truth = recording('lidar_kitti_raw_22scans', 'poses_reference_icp.txt', 0.1, 1)
    plain = KissIcp(0.5, 100.0)
    alone = step_errors([plain.step(scan.points) for scan in scans[:12]], truth)
    ours = step_errors([r.pose for r in run(scans[:12])], truth)
    assert ours[:, 0].mean() < 0.8 * alone[:, 0].mean()


@pytest.mark.real_data
@pytest.mark.slow
def test_still_street_corner_has_almost_no_dynamic_points() -> None:
    scans, _ = recording('lidar_balm_walk_a', 'poses.txt', 0.5, 1)
    results = run(scans[:15])
    share = np.mean(np.concatenate([r.dynamic_probability > 0.5 for r in results]))
    assert share < 0.005
