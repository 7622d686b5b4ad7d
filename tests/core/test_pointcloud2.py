# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybridreg_ros.core.errors import PointCloudError
from hybridreg_ros.core.pointcloud2 import (
    CloudData,
    Field,
    field_values,
    from_arrays,
    has_field,
    to_scan,
    with_field,
)

NUMPY_OF_CODE = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}


def message(cloud: CloudData, stamp_ns: int = 5_000_000_123, frame_id: str = 'lidar'):
    header = SimpleNamespace(
        stamp=SimpleNamespace(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9), frame_id=frame_id
    )
    values = {f.name: getattr(cloud, f.name) for f in dataclasses.fields(cloud)}
    return SimpleNamespace(header=header, **values)


def packed(points, fields, step, *, big=False, height=1, row_padding=0, extra=None):
    """Write a cloud byte by byte with struct-like numpy scalars: independent of the encoder."""
    n = len(points)
    width = n // height
    order = '>' if big else '<'
    row_step = width * step + row_padding
    data = np.full(height * row_step, 0xAB, dtype=np.uint8)
    for i in range(n):
        start = (i // width) * row_step + (i % width) * step
        for f in fields:
            source = points[i]['xyz'.index(f.name)] if f.name in 'xyz' else extra[f.name][i]
            raw = np.array(source, dtype=order + NUMPY_OF_CODE[f.datatype]).tobytes()
            data[start + f.offset : start + f.offset + len(raw)] = np.frombuffer(raw, np.uint8)
    return CloudData(height, width, tuple(fields), big, step, row_step, data, False)


@settings(max_examples=60, deadline=None)
@given(
    code=st.sampled_from([1, 2, 3, 4, 5, 6, 7, 8]),
    gap=st.integers(0, 5),
    tail=st.integers(0, 7),
    big=st.booleans(),
    row_padding=st.integers(0, 9),
    height=st.sampled_from([1, 2, 3]),
    seed=st.integers(0, 2**16),
)
def test_every_layout_decodes(code, gap, tail, big, row_padding, height, seed):
    rng = np.random.default_rng(seed)
    points = rng.integers(1, 100, (6, 3)).astype(float)
    size = np.dtype(NUMPY_OF_CODE[code]).itemsize
    fields = [Field(a, gap + k * (size + gap), code, 1) for k, a in enumerate('zxy')]
    step = 3 * (size + gap) + gap + tail
    cloud = packed(points, fields, step, big=big, height=height, row_padding=row_padding)
    scan = to_scan(message(cloud))
    np.testing.assert_array_equal(scan.points, points.astype(np.float32))
    assert scan.stamp == 5_000_000_123
    assert scan.frame_id == 'lidar'
    assert scan.shape == (height, 6 // height)


def test_one_mask_for_all_fields():
    points = np.array([[1, 2, 3], [np.nan, 0, 0], [4, 5, np.inf], [7, 8, 9]], dtype=float)
    t = np.array([0.0, 0.01, 0.02, 0.03], dtype=np.float32)
    scan = to_scan(message(from_arrays(points, {'t': t})))
    np.testing.assert_array_equal(scan.rows, [0, 3])
    assert scan.times is not None
    np.testing.assert_allclose(scan.times, [0.0, 0.03], atol=1e-7)
    assert (len(scan), scan.size, scan.dropped) == (2, 4, 2)


def test_no_return_is_left_out_with_one_mask():
    points = np.array([[1, 2, 3], [0, 0, 0], [np.nan, 0, 0], [0.001, 0, 0], [7, 8, 9]])
    scan = to_scan(message(from_arrays(points, {'t': np.linspace(0, 0.1, 5)})))
    np.testing.assert_array_equal(scan.rows, [0, 4])
    assert scan.times is not None
    np.testing.assert_allclose(scan.times, [0.0, 0.1])
    assert (scan.size, scan.dropped, scan.near) == (5, 3, 2)
    far = scan.beyond(5.0)
    np.testing.assert_array_equal(far.points, [[7, 8, 9]])
    np.testing.assert_array_equal(far.rows, [4])
    assert far.times is not None
    np.testing.assert_allclose(far.times, [0.1])
    assert (far.size, far.dropped, far.near) == (5, 4, 3)
    assert far.beyond(1.0) is far


def test_float64_overflowing_float32_is_dropped():
    fields = [Field(a, 8 * k, 8, 1) for k, a in enumerate('xyz')]
    cloud = packed(np.array([[1e300, 0, 0], [1, 2, 3]]), fields, 24)
    np.testing.assert_array_equal(to_scan(message(cloud)).rows, [1])


def test_empty_cloud_is_an_empty_scan():
    scan = to_scan(message(from_arrays(np.zeros((0, 3)))))
    assert len(scan) == 0
    assert scan.times is None


def test_count_and_zero_count():
    fields = (Field('x', 0, 7, 1), Field('y', 4, 7, 0), Field('z', 8, 7, 1), Field('n', 12, 7, 3))
    data = np.arange(12, dtype='<f4').view(np.uint8)
    cloud = CloudData(1, 2, fields, False, 24, 48, data, True)
    np.testing.assert_array_equal(to_scan(message(cloud)).points, [[0, 1, 2], [6, 7, 8]])
    np.testing.assert_array_equal(field_values(message(cloud), 'n'), [3, 9])


def test_round_trip_with_extra_fields(rng):
    points = rng.normal(size=(12, 3)).astype(np.float32)
    extra = {'label': np.arange(12, dtype=np.uint8), 'd': rng.normal(size=12)}
    msg = message(from_arrays(points, extra, shape=(3, 4)))
    np.testing.assert_array_equal(to_scan(msg).points, points)
    np.testing.assert_array_equal(field_values(msg, 'label'), extra['label'])
    np.testing.assert_array_equal(field_values(msg, 'd'), extra['d'])
    assert has_field(msg, 'd')
    assert not has_field(msg, 'e')


@pytest.mark.parametrize('big', [False, True])
def test_with_field_keeps_the_input(big, rng):
    points = rng.normal(size=(5, 3))
    points[1] = np.nan
    fields = [Field(a, 4 * k, 7, 1) for k, a in enumerate('xyz')] + [Field('ring', 12, 4, 1)]
    ring = np.array([5, 6, 7, 8, 9])
    msg = message(packed(points, fields, 18, big=big, extra={'ring': ring}))
    scan = to_scan(msg)
    p = np.array([0.1, 0.9, 0.2, 0.8], dtype=np.float32)
    out = message(with_field(msg, scan, 'dynamic_probability', p, p > 0.5))
    np.testing.assert_array_equal(field_values(out, 'dynamic_probability'), p[p > 0.5])
    np.testing.assert_array_equal(field_values(out, 'ring'), [7, 9])
    np.testing.assert_array_equal(to_scan(out).points, points[[2, 4]].astype(np.float32))
    assert out.is_bigendian == big
    again = with_field(out, to_scan(out), 'dynamic_probability', p[:2], np.ones(2, bool))
    assert again.point_step == out.point_step


TURN_S = np.linspace(0.0, 0.1, 40)
EPOCH_S = 1_760_000_000
SICK_NS = (TURN_S * 1e9).astype(np.int64) + 948_000_000  # a second ends within the scan
DRIVERS: dict[str, dict[str, np.ndarray]] = {
    'ouster': {'t': (TURN_S * 1e9).astype(np.uint32)},
    'velodyne': {'time': TURN_S.astype(np.float32)},
    'hesai': {'timestamp': TURN_S + EPOCH_S},
    'robosense': {'timestamp': TURN_S + EPOCH_S, 'ring': np.zeros(40, np.uint16)},
    'livox': {'timestamp': (TURN_S + EPOCH_S) * 1e9},
    'livox custom': {'offset_time': (TURN_S * 1e9).astype(np.uint32)},
    'blickfeld': {'point_time_offset': (TURN_S * 1e9).astype(np.uint32)},
    'argoverse': {'offset_ns': (TURN_S * 1e9).astype(np.int32)},
    'lio': {'time_offset': TURN_S.astype(np.float32)},
    'sick': {
        'lidar_sec': (EPOCH_S + SICK_NS // 10**9).astype(np.uint32),
        'lidar_nsec': (SICK_NS % 10**9).astype(np.uint32),
    },
    'sick, nanoseconds alone': {'lidar_nsec': (SICK_NS % 10**9).astype(np.uint32)},
    'sick, microseconds': {'t': (TURN_S * 1e6).astype(np.uint32)},
    'fast-lio': {'curvature': (TURN_S * 1e3).astype(np.float32)},
    'list': {'stamps': TURN_S},
    'capitals': {'Timestamp': TURN_S + EPOCH_S},
    'first field unused': {'t': np.zeros(40, np.uint32), 'timestamp': TURN_S + EPOCH_S},
}


@pytest.mark.parametrize('driver', DRIVERS)
def test_times_of_every_driver(driver, rng):
    fields = DRIVERS[driver]
    msg = message(from_arrays(rng.normal(size=(40, 3)), fields), EPOCH_S * 10**9)
    scan = to_scan(msg)
    assert scan.times is not None
    first = scan.times[0] if driver.startswith('sick') else 0.0
    np.testing.assert_allclose(scan.times - first, TURN_S, atol=1e-6)
    assert scan.times_from.split(' ')[0] in fields
    assert scan.notes == ()


def test_what_is_used_and_why_not(rng):
    points = rng.normal(size=(40, 3))
    surface = rng.uniform(0, 0.33, 40).astype(np.float32)
    scan = to_scan(message(from_arrays(points, {'curvature': surface})))
    assert scan.times is None, 'the curvature of a surface is no time'
    assert scan.times_from == 'none: no time field is usable'
    assert 'field curvature: span' in scan.notes[0]
    scan = to_scan(message(from_arrays(points, {'intensity': surface})))
    assert scan.times_from == 'none: no known time field in x, y, z, intensity'
    msg = message(from_arrays(points, {'when': TURN_S, 't': TURN_S * 2}))
    assert to_scan(msg).times_from == 't (s)'
    scan = to_scan(msg, time_field='when')
    assert scan.times_from == 'when (s)'
    assert scan.times is not None
    np.testing.assert_allclose(scan.times, TURN_S)
    scan = to_scan(msg, time_field='then')
    assert (scan.times, scan.times_from) == (None, 'none: no field then')
    assert scan.notes == ('no field then in: x, y, z, when, t',)
    assert to_scan(msg, time_unit='none').times_from == 'none: time_unit is none'


def test_a_point_of_another_scan_is_left_out_of_every_field(rng):
    t = TURN_S.copy()
    t[5] = 3.6
    scan = to_scan(message(from_arrays(rng.normal(size=(40, 3)), {'t': t})))
    assert (len(scan), scan.dropped) == (39, 1)
    assert 5 not in scan.rows
    assert scan.times is not None
    np.testing.assert_allclose(scan.times, np.delete(TURN_S, 5))
    assert scan.notes == ('field t: 1 points left out whose times are not those of the scan',)


def test_millimetres_are_noted(rng):
    points = rng.uniform(-8, 8, (200, 3))
    assert to_scan(message(from_arrays(points))).notes == ()
    (note,) = to_scan(message(from_arrays(1000.0 * points))).notes
    assert 'expected metres, this looks like millimetres' in note


def good():
    return from_arrays(np.arange(30, dtype=np.float32).reshape(10, 3))


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        ({'fields': ()}, 'lacks field x, y, z; found: none'),
        ({'fields': (Field('x', 0, 7, 1),)}, 'lacks field y, z; found: x'),
        ({'point_step': 8}, 'wrong point_step'),
        ({'point_step': 0}, 'point_step is 0'),
        ({'point_step': 1 << 17}, 'point_step is 131072, expected at most 65536'),
        ({'row_step': 10}, 'row_step is 10, expected >= '),
        ({'data': np.zeros(7, np.uint8)}, 'truncated data: 1x10 points need 120 bytes, found 7'),
        ({'fields': (Field('x', 0, 9, 1),)}, 'unknown datatype 9'),
        ({'fields': (Field('x', 0, 7, 1), Field('x', 4, 7, 1))}, 'lacks field y, z'),
        ({'fields': (Field('x', -4, 7, 1),)}, 'wrong point_step'),
    ],
)
def test_broken_layouts_are_one_line(change, text):
    with pytest.raises(PointCloudError, match=text) as caught:
        to_scan(message(dataclasses.replace(good(), **change)))
    assert '\n' not in str(caught.value)


def test_doubled_fields_and_capital_letters_are_read(rng):
    """The first of two fields of one name counts; both go out again."""
    points = rng.normal(size=(6, 3))
    fields = [Field(a, 4 * k, 7, 1) for k, a in enumerate('xyz')]
    cloud = packed(points, fields, 20)
    fields += [Field('x', 12, 7, 1), Field('', 16, 7, 1)]
    msg = message(dataclasses.replace(cloud, fields=tuple(fields)))
    scan = to_scan(msg)
    np.testing.assert_array_equal(scan.points, points.astype(np.float32))
    out = with_field(msg, scan, 'p', np.zeros(6, np.float32), np.ones(6, bool))
    assert [f.name for f in out.fields] == ['x', 'y', 'z', 'x', '', 'p']
    fields = [f._replace(name=f.name.upper()) for f in fields[:3]]
    scan = to_scan(message(dataclasses.replace(cloud, fields=tuple(fields))))
    np.testing.assert_array_equal(scan.points, points.astype(np.float32))


def test_encoder_and_field_errors():
    points = np.ones((2, 3), np.float32)
    with pytest.raises(PointCloudError, match=r'field a must be \(2,\)'):
        from_arrays(points, {'a': np.zeros(3)})
    with pytest.raises(PointCloudError, match='cannot hold complex'):
        from_arrays(points, {'a': np.zeros(2, complex)})
    with pytest.raises(PointCloudError, match='does not hold 2 points'):
        from_arrays(points, shape=(2, 2))
    msg = message(from_arrays(points))
    scan = to_scan(msg)
    with pytest.raises(PointCloudError, match='expected 2 values'):
        with_field(msg, scan, 'p', np.zeros(3, np.float32), np.ones(2, bool))
    with pytest.raises(PointCloudError, match='lacks field label'):
        field_values(msg, 'label')
    msg = message(from_arrays(points, {'p': np.zeros(2, np.uint8)}))
    with pytest.raises(PointCloudError, match='exists with datatype 2, expected 7'):
        with_field(msg, scan, 'p', np.zeros(2, np.float32), np.ones(2, bool))


def test_large_clouds_are_thinned_and_their_rows_stay_known():
    points = np.arange(33, dtype=np.float32).reshape(11, 3)
    points[3] = np.nan
    msg = message(from_arrays(points, {'t': np.linspace(0.0, 0.1, 11)}))
    scan = to_scan(msg, max_points=4)
    np.testing.assert_array_equal(scan.rows, [0, 6, 9])
    np.testing.assert_array_equal(scan.points, points[[0, 6, 9]])
    assert scan.times == pytest.approx([0.0, 0.06, 0.09])
    assert (scan.size, scan.thinned, scan.dropped) == (11, 7, 1)
    assert len(to_scan(msg, max_points=11)) == len(to_scan(msg)) == 10
