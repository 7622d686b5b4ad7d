# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros import Scan
from hybridreg_ros.core.errors import PointCloudError


def test_seconds_and_nanoseconds():
    points = np.zeros((2, 3))
    assert Scan(points, stamp=1.5).stamp == 1_500_000_000
    assert Scan(points, stamp=7).stamp == 7
    assert Scan(points, stamp=1.5).stamp_s == 1.5


def test_defaults():
    scan = Scan(np.zeros((4, 3)))
    assert scan.points.dtype == np.float32
    assert (len(scan), scan.size, scan.dropped, scan.shape) == (4, 4, 0, (1, 4))
    np.testing.assert_array_equal(scan.rows, [0, 1, 2, 3])
    assert Scan(np.zeros((0, 3))).rows.shape == (0,)


@pytest.mark.parametrize(
    ('arguments', 'text'),
    [
        ({'points': np.zeros((4, 2))}, r'must be \(N, 3\), found \(4, 2\)'),
        ({'points': np.full((2, 3), np.nan)}, 'NaN or inf'),
        ({'points': np.zeros((2, 3)), 'times': np.zeros(3)}, r'times must be \(2,\)'),
        ({'points': np.zeros((2, 3)), 'rows': np.zeros(3, int)}, r'rows must be \(2,\)'),
    ],
)
def test_refuses_inconsistent_fields(arguments, text):
    with pytest.raises(PointCloudError, match=text):
        Scan(**arguments)
