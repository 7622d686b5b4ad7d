# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Development sequences seen through a window: the same frames, fewer of their points."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.benchmark import suite_data
from hybridreg_ros.benchmark.suite_list import SEQUENCES

if TYPE_CHECKING:
    from pathlib import Path


def test_narrow_sequence_is_the_middle_of_the_wide_one(tmp_path: Path) -> None:
    count = 3
    rng = np.random.default_rng(2)
    points = rng.uniform([-2.0, -2.0, 1.0], [2.0, 2.0, 5.0], (300, 3)).astype(np.float32)
    np.savez(
        tmp_path / 'room_502_30-50_3.npz',
        stamps=np.arange(count) * 100_000_000,
        poses=np.tile(np.eye(4), (count, 1, 1)),
        sizes=np.full(count, 100),
        points=points,
        moving=rng.random(300) < 0.4,
        times=np.zeros(0),
    )
    narrow = replace(SEQUENCES['dev-narrow-502'], frames=count)
    wide = suite_data.load(replace(narrow, window=0.0), tmp_path, tmp_path)
    for frame, whole in zip(suite_data.load(narrow, tmp_path, tmp_path), wide, strict=True):
        inside = np.abs(whole.scan.points[:, :2] / whole.scan.points[:, 2:]).max(axis=1) < 0.15
        assert 0 < inside.sum() < len(inside)
        assert whole.moving is not None
        np.testing.assert_array_equal(frame.scan.points, whole.scan.points[inside])
        np.testing.assert_array_equal(frame.moving, whole.moving[inside])
        assert frame.scan.stamp == whole.scan.stamp
