# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Development sequences whose motion during each scan is undone, as in prepared recordings."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.benchmark import suite_data
from hybridreg_ros.benchmark.suite_list import SEQUENCES
from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import FileFormatError

if TYPE_CHECKING:
    from pathlib import Path

TWIST = np.array([6.0, 0.3, 0.0, 0.0, 0.2, 0.5])


def test_deskewed_points_lie_where_the_still_world_is(tmp_path: Path) -> None:
    count, each = 3, 200
    rng = np.random.default_rng(4)
    world = rng.uniform([-20.0, -20.0, -2.0], [20.0, 20.0, 6.0], (count, each, 3))
    times = np.sort(rng.uniform(0.0, 0.1, (count, each)), axis=1)
    poses = [se3.exp(0.1 * k * TWIST) for k in range(count)]
    measured = [
        se3.apply(se3.inverse(se3.exp((0.1 * k + t) * TWIST)), p[None])[0]
        for k in range(count)
        for t, p in zip(times[k], world[k], strict=True)
    ]
    np.savez(
        tmp_path / 'street_8301_none_3.npz',
        stamps=np.arange(count) * 100_000_000,
        poses=np.array(poses),
        sizes=np.full(count, each),
        points=np.array(measured, np.float32),
        moving=np.zeros(count * each, bool),
        times=times.ravel(),
    )
    plain = replace(SEQUENCES['dev-street-plain-8301'], frames=count)
    frames = suite_data.load(plain, tmp_path, tmp_path)
    as_measured = suite_data.load(replace(plain, deskewed=False), tmp_path, tmp_path)
    for k, (frame, skewed) in enumerate(zip(frames, as_measured, strict=True)):
        assert frame.scan.times is None
        assert skewed.scan.times is not None
        placed = se3.apply(frame.T_world_sensor, frame.scan.points)
        assert np.abs(placed - world[k]).max() < 1e-3
        smeared = se3.apply(skewed.T_world_sensor, skewed.scan.points)
        assert np.abs(smeared - world[k]).max() > 0.5


def test_without_times_no_motion_can_be_undone(tmp_path: Path) -> None:
    np.savez(
        tmp_path / 'street_8301_none_2.npz',
        stamps=np.arange(2) * 100_000_000,
        poses=np.stack([np.eye(4)] * 2),
        sizes=np.full(2, 5),
        points=np.ones((10, 3), np.float32),
        moving=np.zeros(10, bool),
        times=np.zeros(0),
    )
    plain = replace(SEQUENCES['dev-street-plain-8301'], frames=2)
    with pytest.raises(FileFormatError, match='no times per point'):
        suite_data.load(plain, tmp_path, tmp_path)
