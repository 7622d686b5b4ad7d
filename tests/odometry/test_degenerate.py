# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Where nothing holds a direction the odometry says so instead of being sure of the pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybridreg_ros.benchmark.places import GATE, Score, all_places
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.registration.gauss_newton import unheld
from hybridreg_ros.odometry.result import Reason

PLACES = {place.name: place for place in all_places()}


@pytest.mark.parametrize(
    ('name', 'reason'),
    [
        ('tunnel', Reason.DEGENERATE),
        ('corridor', Reason.DEGENERATE),
        ('wall', Reason.DEGENERATE),
        ('hall', Reason.DEGENERATE),
        ('field', Reason.LOW_CONFIDENCE),
    ],
)
def test_what_nothing_holds_is_told(name: str, reason: Reason) -> None:
    odometry, score, results = HybridOdometry(), Score(), []
    for scan, truth in replace(PLACES[name], scans=14).clouds():
        results.append(odometry.step(scan))
        score.add(results[-1], truth)
    assert {r.reason for r in results[1:]} == {reason}
    assert max(r.confidence for r in results[1:]) < GATE
    assert score.wrong_above_gate == 0
    if name in {'tunnel', 'corridor', 'wall'}:  # in the hall it is the turn that nothing holds
        direction = results[-1].weak_direction
        assert direction is not None
        assert np.sqrt(direction @ results[-1].covariance[:3, :3] @ direction) > 0.5
        assert name == 'wall' or abs(direction[0]) > 0.99
        assert score.errors[-1] > 0.5  # nobody could know how fast it goes


def test_no_step_of_stairs_is_left_out() -> None:
    odometry, score = HybridOdometry(), Score()
    for scan, truth in replace(PLACES['stairs'], scans=8).clouds():
        score.add(odometry.step(scan), truth)
    assert max(score.errors) < 0.02  # a step is 0.33 m long, and 0.06 m a scan
    assert min(score.confidences) >= GATE


def test_only_what_no_surface_holds_is_free() -> None:
    any_way = np.diag([3e6] * 3 + [3e7] * 3)
    H = any_way / 3.0
    assert not unheld(H, any_way).any()
    H[0, 0] = 0.001 * any_way[0, 0]
    expected = np.zeros((6, 6))
    expected[0, 0] = 1.0
    np.testing.assert_allclose(unheld(H, any_way), expected, atol=1e-9)
