# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybridreg_ros.core.errors import PointCloudError
from hybridreg_ros.core.point_times import to_seconds

STAMP = 1_760_000_000_250_000_000
TRUE_S = np.linspace(0.0, 0.1, 50)


def read(raw, stamp, **options):
    found = to_seconds(raw, stamp, **options)
    return found.seconds, found.note


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
    times, note = read(raw, STAMP)
    assert note == ''
    assert times is not None
    np.testing.assert_allclose(times, TRUE_S, atol=2e-6)


def test_hesai_epoch_seconds():
    # A float64 holds epoch seconds to 0.24 microseconds.
    times, note = read(TRUE_S + STAMP / 1e9, STAMP)
    np.testing.assert_allclose(times, TRUE_S, atol=1e-6)
    assert note == ''


def test_negative_times_mean_the_stamp_is_the_end():
    times, _ = read((TRUE_S - 0.1).astype(np.float32), STAMP)
    np.testing.assert_allclose(times, TRUE_S - 0.1, atol=1e-7)


def test_foreign_clock_is_anchored_at_the_first_point():
    times, _ = read((TRUE_S * 1e9).astype(np.uint64) + np.uint64(77 * 10**9), STAMP)
    np.testing.assert_allclose(times, TRUE_S, atol=2e-9)


def test_given_unit_wins():
    times, _ = read(TRUE_S * 10, STAMP, unit='s')
    np.testing.assert_allclose(times, TRUE_S * 10)
    times, _ = read(TRUE_S * 10, STAMP, unit='normalised', scan_period_s=0.05)
    np.testing.assert_allclose(times, TRUE_S / 2)


@pytest.mark.parametrize(
    ('raw', 'text'),
    [
        (np.zeros(4), 'all per-point times are equal'),
        (np.array([0.0, np.nan, 0.1]), '1 of 3 per-point times are NaN'),
        (np.array([0.0, np.inf, 0.1]), '1 of 3 per-point times are NaN or inf'),
        (np.array([0.0, 1e-9]), 'fits no time unit'),
        (np.array([0.0, 1e15]), 'fits no time unit'),
    ],
)
def test_unusable_times_give_a_note(raw, text):
    times, note = read(raw, STAMP)
    assert times is None
    assert text in note


def test_given_unit_with_absurd_span():
    times, note = read(TRUE_S * 1e9, STAMP, unit='s')
    assert times is None
    assert 'exceeds 1 s' in note


def test_unknown_unit():
    with pytest.raises(PointCloudError, match="time unit 'fortnight'"):
        to_seconds(TRUE_S, STAMP, unit='fortnight')


@pytest.mark.parametrize(
    ('name', 'raw'),
    [
        ('relative seconds', TRUE_S.astype(np.float32)),
        ('relative nanoseconds', (TRUE_S * 1e9).astype(np.uint32)),
        ('epoch seconds', TRUE_S + STAMP / 1e9),
        ('epoch nanoseconds', (TRUE_S * 1e9).astype(np.uint64) + np.uint64(STAMP)),
    ],
)
@pytest.mark.parametrize('odd', [0, 3.6, 4e9, 'nan'])
def test_a_few_odd_times_do_not_decide(name, raw, odd):
    """One point with t = 3.6 s, or one zero among epoch times, costs that point alone."""
    raw = raw.copy()
    if odd == 'nan' and raw.dtype.kind != 'f':
        pytest.skip('whole numbers hold no NaN')
    raw[[7, 30]] = np.nan if odd == 'nan' else np.asarray(odd).astype(raw.dtype)
    found = to_seconds(raw, STAMP)
    assert found.seconds is not None
    good = np.delete(np.arange(50), [7, 30])
    np.testing.assert_allclose(found.seconds[good], TRUE_S[good], atol=1e-6)
    if found.keep.all():  # zero, or 3.6 ns, is a time of this scan
        assert name.startswith('relative')
        assert np.ptp(found.seconds) <= 0.1 + 1e-6
    else:
        assert np.flatnonzero(~found.keep).tolist() == [7, 30]
        assert found.note == '2 points left out whose times are not those of the scan'


def test_sparse_directions_are_no_outliers():
    """A wall takes 96 % of the points in a quarter of the turn; the rest of the turn counts."""
    raw = np.concatenate([np.linspace(0.0, 0.025, 960), np.linspace(0.025, 0.1, 40)])
    assert to_seconds(raw, STAMP).keep.all()


@settings(max_examples=200, deadline=None)
@given(
    st.sampled_from(['i1', 'u1', 'i2', 'u2', 'i4', 'u4', 'i8', 'u8', 'f4', 'f8']),
    st.binary(min_size=8, max_size=400),
)
def test_any_bytes_give_believable_times_or_a_note(kind, data):
    raw = np.frombuffer(data[: len(data) // 8 * 8], kind)
    found = to_seconds(raw, STAMP)
    if found.seconds is None:
        assert found.note
    else:
        kept = found.seconds[found.keep]
        assert 0.0 < np.ptp(kept) <= 1.0 + 1e-9
        assert np.abs(kept).max() <= 2.0 + 1e-9


def test_signalling_nan_is_left_out_without_a_warning():
    raw = np.linspace(0.0, 0.1, 100, dtype=np.float32)
    raw.view(np.uint32)[7] = 0x7F80_0001
    with np.errstate(invalid='raise'):
        found = to_seconds(raw, 0)
    assert found.seconds is not None
    assert np.flatnonzero(~found.keep).tolist() == [7]
