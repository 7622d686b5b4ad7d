# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Predictions that follow a guide."""

from __future__ import annotations

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.motion.guided import GuidedMotion

STEP = se3.exp(np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.2]))


def test_a_guide_says_where_the_next_scan_is_and_is_asked_once():
    asked = []

    def guide(since: int, until: int, steady: np.ndarray) -> np.ndarray:
        asked.append((since, until))
        np.testing.assert_allclose(steady, np.eye(4), atol=1e-12)
        return STEP

    motion = GuidedMotion(guide)
    start = se3.exp(np.array([1.0, 2.0, 0.0, 0.0, 0.0, 1.0]))
    motion.stop(100, start)
    for _ in range(2):
        np.testing.assert_allclose(motion.predict(200), start @ STEP)
    np.testing.assert_allclose(motion.expect(200).pose, start @ STEP)
    assert asked == [(100, 200)]
    motion.advance(start @ STEP, 200)
    assert motion.twist[0] > 0.0


def test_a_guide_that_knows_nothing_leaves_constant_velocity():
    motion = GuidedMotion(lambda since, until, steady: steady)
    motion.advance(np.eye(4), 10**9)
    motion.advance(STEP, 2 * 10**9)
    np.testing.assert_allclose(motion.predict(3 * 10**9), STEP @ STEP, atol=1e-12)


def test_a_measured_rate_is_what_the_next_scan_is_deskewed_by():
    motion = GuidedMotion(lambda since, until, steady: steady)
    motion.advance(np.eye(4), 10**9)
    motion.advance(STEP, 2 * 10**9)
    linear = motion.twist[:3].copy()
    motion.turn(np.array([0.0, 0.0, 3.0]))
    np.testing.assert_array_equal(motion.twist, [*linear, 0.0, 0.0, 3.0])
