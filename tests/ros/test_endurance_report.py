# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The endurance report counts what happens to every cloud."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')
pytest.importorskip('natsort')

from ros_harness import KISS, room

from hybridreg_ros.core.scan import Scan

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'scripts'))
endurance = pytest.importorskip('endurance_report')

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(('count', 'real'), [(102, False), (20, True)])
def test_every_cloud_is_accounted_for(count, real):
    clouds = [Scan(room(0.05 * k), stamp=k) for k in range(8)]
    found = endurance.endure(clouds, count, real, KISS)
    assert found.sent == count
    assert found.lost == 0
    assert found.answered + sum(found.dropped.values()) == count
    assert real or not found.dropped
    assert found.late_mb > 50.0
    assert (found.early_mb > 50.0) is (count > 100)


def test_what_only_the_transport_lost_is_lost():
    dropped = {'queue_full': 3, 'lost_in_transport': 2}
    assert endurance.Endurance(100, 94, dropped, 0.0, 0.0, 1.0).lost == 3
