# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.core.errors import PointCloudError
from hybridreg_ros.core.point_times import to_seconds

STAMP = 1_760_000_000_250_000_000
TRUE_S = np.linspace(0.0, 0.1, 50)


@pytest.mark.parametrize(
    ('name', 'raw'),
    [
        ('ouster t', (TRUE_S * 1e9).astype(np.uint32)),
        ('livox offset_time as float64', TRUE_S * 1e9),
        ('velodyne time', TRUE_S.astype(np.float32)),
        ('microseconds', (TRUE_S * 1e6).astype(np.uint32)),
        ('milliseconds', (TRUE_S * 1e3).astype(np.float32)),
        ('normalised', (TRUE_S * 10).astype(np.float32)),
        ('absolute nanoseconds', (TRUE_S * 1e9).astype(np.uint64) + np.uint64(STAMP)),
    ],
)
def test_units_found_by_themselves(name, raw):
    times, note = to_seconds(raw, STAMP)
    assert note == ''
    assert times is not None
    np.testing.assert_allclose(times, TRUE_S, atol=2e-6)


def test_hesai_epoch_seconds():
    # A float64 holds epoch seconds to 0.24 microseconds.
    times, note = to_seconds(TRUE_S + STAMP / 1e9, STAMP)
    assert times is not None
    np.testing.assert_allclose(times, TRUE_S, atol=1e-6)
    assert note == ''


def test_negative_times_mean_the_stamp_is_the_end():
    times, _ = to_seconds((TRUE_S - 0.1).astype(np.float32), STAMP)
    assert times is not None
    np.testing.assert_allclose(times, TRUE_S - 0.1, atol=1e-7)


def test_foreign_clock_is_anchored_at_the_first_point():
    times, _ = to_seconds((TRUE_S * 1e9).astype(np.uint64) + np.uint64(77 * 10**9), STAMP)
    assert times is not None
    np.testing.assert_allclose(times, TRUE_S, atol=2e-9)


def test_given_unit_wins():
    times, _ = to_seconds(TRUE_S * 10, STAMP, unit='s')
    assert times is not None
    np.testing.assert_allclose(times, TRUE_S * 10)
    times, _ = to_seconds(TRUE_S * 10, STAMP, unit='normalised', scan_period_s=0.05)
    assert times is not None
    np.testing.assert_allclose(times, TRUE_S / 2)


@pytest.mark.parametrize(
    ('raw', 'text'),
    [
        (np.zeros(4), 'all per-point times are equal'),
        (np.array([0.0, np.nan, 0.1]), '1 per-point times are NaN'),
        (np.array([0.0, np.inf, 0.1]), '1 per-point times are NaN or inf'),
        (np.array([0.0, 1e-9]), 'fits no time unit'),
        (np.array([0.0, 1e15]), 'fits no time unit'),
    ],
)
def test_unusable_times_give_a_note(raw, text):
    times, note = to_seconds(raw, STAMP)
    assert times is None
    assert text in note


def test_given_unit_with_absurd_span():
    times, note = to_seconds(TRUE_S * 1e9, STAMP, unit='s')
    assert times is None
    assert 'exceeds 5 s' in note


def test_unknown_unit():
    with pytest.raises(PointCloudError, match="time unit 'fortnight'"):
        to_seconds(TRUE_S, STAMP, unit='fortnight')
