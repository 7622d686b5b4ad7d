# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Every bad cloud through the topic: it is counted, diagnosed, and the node lives on."""

from __future__ import annotations

import re
import time
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from array import array

from diagnostic_msgs.msg import DiagnosticStatus
from ros_harness import KISS, STEP_NS, cloud, room, running
from sensor_msgs.msg import PointCloud2

from hybridreg_ros.odometry.result import LOST_VARIANCE
from hybridreg_ros.ros.playback.fuzz_check import check_fuzz

pytestmark = pytest.mark.ros

HOUR_NS = 3_600_000_000_000
_stamps = count(10 * STEP_NS, STEP_NS)


@pytest.fixture(scope='module')
def node():
    """One node for the module: that it lives on is part of every test."""
    with running('bad', max_cloud_points=1_000_000) as p:
        yield p


@pytest.fixture
def probe(node):
    """The node after a reset and one good cloud; a good cloud must pass afterwards too."""
    node.call('reset')
    node.answer(cloud(room(), stamp()))
    yield node
    node.call('reset')
    node.answer(cloud(room(), stamp()))


def stamp() -> int:
    """The next stamp, ns."""
    return next(_stamps)


def dropped(probe, msg: PointCloud2, cause: str, text: str) -> None:
    """Send a cloud that must be dropped for a cause, with a text in the diagnostics."""
    probe.fresh()
    before, total = probe.count(f'dropped.{cause}'), probe.count('dropped')
    levels = probe.watch_levels()
    probe.send(msg)
    probe.wait(lambda: probe.count(f'dropped.{cause}') == before + 1, f'drop for {cause}')
    assert probe.count('dropped') == total + 1
    assert text in probe.values['last_drop']
    probe.wait(lambda: levels - {DiagnosticStatus.OK}, 'a warning')


def edited(**changes) -> PointCloud2:
    """A good cloud with attributes changed."""
    msg = cloud(room(), stamp())
    for name, value in changes.items():
        setattr(msg, name, value)
    return msg


def lacking_z() -> PointCloud2:
    msg = cloud(room(), stamp())
    msg.fields = [f for f in msg.fields if f.name != 'z']
    return msg


def truncated() -> PointCloud2:
    msg = cloud(room(), stamp())
    msg.data = array('B', msg.data[: len(msg.data) // 2])
    return msg


def doubled_field() -> PointCloud2:
    msg = cloud(room(), stamp())
    msg.fields[1].name = 'x'
    return msg


def empty_with_a_huge_point() -> PointCloud2:
    msg = edited(width=0, point_step=2**32 - 1)
    msg.fields[0].count = 2**29
    return msg


def odd_datatype() -> PointCloud2:
    msg = cloud(room(), stamp())
    msg.fields[0].datatype = 77
    return msg


@pytest.mark.parametrize(
    ('make', 'text'),
    [
        (lacking_z, 'lacks field z'),
        (truncated, 'truncated data'),
        (doubled_field, 'lacks field y'),
        (odd_datatype, 'unknown datatype 77'),
        (lambda: edited(point_step=8), 'wrong point_step'),
        (lambda: edited(point_step=0), 'point_step'),
        (empty_with_a_huge_point, 'point_step is 4294967295, expected at most 65536'),
        (lambda: edited(row_step=5), 'row_step is 5'),
        (lambda: edited(fields=[]), 'lacks field x'),
        (lambda: edited(width=5000), 'row_step'),
        (lambda: edited(data=array('B')), 'truncated data'),
    ],
)
def test_broken_layout_is_a_counted_drop(probe, make, text):
    dropped(probe, make(), 'bad_cloud', text)


def test_too_many_points_are_a_counted_drop(probe):
    msg = cloud(np.zeros((1_000_001, 3), np.float32), stamp())
    dropped(probe, msg, 'too_many_points', '1000001 points, max_cloud_points is 1000000')


@pytest.mark.parametrize(
    'points',
    [
        np.zeros((0, 3)),
        np.ones((1, 3)),
        np.full((500, 3), np.nan),
        np.full((500, 3), np.inf),
        np.full((500, 3), 1e9),
        np.ones((5000, 3)),
    ],
    ids=['empty', 'one_point', 'all_nan', 'inf', '1e9', 'all_equal'],
)
def test_clouds_without_shape_give_no_pose_of_their_own(probe, points):
    probe.fresh()
    levels = probe.watch_levels()
    poor = sum(n for key, n in probe.counters() if key.startswith('poor.'))
    for _ in range(3):
        msg = probe.answer(cloud(points.astype(np.float32), stamp()))
    assert np.diag(np.array(msg.pose.covariance).reshape(6, 6)).min() >= LOST_VARIANCE
    probe.wait(lambda: probe.values['source'] == 'lost', 'lost')
    probe.wait(lambda: DiagnosticStatus.ERROR in levels, 'an error')
    assert sum(n for key, n in probe.counters() if key.startswith('poor.')) == poor + 3


def test_diagnostics_do_not_turn_ok_between_bad_clouds(probe):
    assert probe.set('input_timeout_s', 0.3).successful
    probe.wait(lambda: probe.level == DiagnosticStatus.WARN, 'silence')
    broken = truncated()
    probe.send(broken)
    probe.wait(lambda: 'no odometry for' in probe.text, 'the age of the odometry')
    levels = probe.watch_levels()
    for _ in range(8):
        probe.send(broken)
        time.sleep(0.25)  # two or three diagnostics come, without a drop since the last one
    assert DiagnosticStatus.OK not in levels
    assert 'bad_cloud: truncated data' in probe.text
    assert float(probe.values['odometry_age_s']) > 2.0
    probe.answer(cloud(room(), stamp()))
    probe.wait(lambda: 'no odometry' not in probe.text, 'the end of the warning')
    assert probe.set('input_timeout_s', 2.0).successful


def test_lost_is_left_again(probe):
    for _ in range(3):
        probe.answer(cloud(np.zeros((0, 3), np.float32), stamp()))
    probe.wait(lambda: probe.level == DiagnosticStatus.ERROR, 'an error')
    msg = probe.answer(cloud(room(), stamp()))
    assert np.diag(np.array(msg.pose.covariance).reshape(6, 6)).max() < 1.0
    probe.wait(lambda: 'lost to kiss_icp' in probe.values['last_switch'], 'the switch')
    assert 'recovered' in probe.values['last_switch']


def test_some_nan_inf_and_far_points_do_no_harm(probe):
    points = room(0.05)
    points[::7], points[1::9], points[2::11] = np.nan, np.inf, 1e9
    before = probe.count('invalid_points')
    p = probe.answer(cloud(points, stamp())).pose.pose.position
    assert p.x == pytest.approx(0.05, abs=0.03)
    probe.wait(lambda: probe.count('invalid_points') > before, 'the count')


def test_big_endian_is_read(probe):
    msg = cloud(room(0.05), stamp())
    msg.data = array('B', np.frombuffer(msg.data, '<f4').astype('>f4').tobytes())
    msg.is_bigendian = True
    assert probe.answer(msg).pose.pose.position.x == pytest.approx(0.05, abs=0.03)


def test_row_padding_is_skipped(probe):
    points = room(0.05)[:2800]
    msg = cloud(points, stamp())
    rows = np.frombuffer(msg.data, np.uint8).reshape(28, -1)
    padded = np.concatenate([rows, np.full((28, 13), 255, np.uint8)], axis=1)
    msg.height, msg.width, msg.row_step = 28, 100, padded.shape[1]
    msg.data = array('B', padded.tobytes())
    assert probe.answer(msg).pose.pose.position.x == pytest.approx(0.05, abs=0.03)


@pytest.mark.parametrize(
    ('offset_ns', 'cause'),
    [(0, 'stamp_repeated'), (-5 * STEP_NS, 'stamp_backwards'), (HOUR_NS, 'stamp_jump')],
)
def test_odd_stamps_are_counted_drops(probe, offset_ns, cause):
    s = stamp()
    probe.answer(cloud(room(), s))
    received = len(probe.odometry)
    dropped(probe, cloud(room(), s + offset_ns), cause, f'cloud at {(s + offset_ns) / 1e9:.3f} s')
    assert len(probe.odometry) == received


def test_another_frame_is_a_counted_drop(probe):
    dropped(probe, cloud(room(), stamp(), 'camera'), 'frame_changed', "frame 'camera'")


@pytest.mark.parametrize(
    'times',
    [
        np.zeros(3500, np.float32),
        np.full(3500, np.nan, np.float32),
        np.full(3500, 1e30, np.float32),
        np.linspace(-1e9, 1e9, 3500).astype(np.float32),
    ],
    ids=['equal', 'nan', 'huge', 'wide'],
)
def test_bad_times_are_said_and_not_used(probe, times):
    points = room(0.05)
    msg = probe.answer(cloud(points, stamp(), t=np.resize(times, len(points))))
    assert msg.pose.pose.position.x == pytest.approx(0.05, abs=0.03)
    probe.fresh()
    assert probe.values['deskewed'] == 'false'
    assert probe.values['point_times'].startswith('none: ')


def test_flood_keeps_the_newest_and_counts_the_rest(probe):
    assert probe.set('queue_depth', 1).successful
    probe.fresh()
    before = dict(probe.counters())
    received = len(probe.odometry)
    stamps = [stamp() for _ in range(30)]
    points = np.tile(room(), (20, 1))
    for s in stamps:
        probe.send(cloud(points, s))
    probe.wait(lambda: probe.at(stamps[-1]), 'the newest cloud')
    probe.fresh()
    after = dict(probe.counters())
    gone = sum(n - before.get(k, 0) for k, n in after.items() if k.startswith('dropped.'))
    assert gone > 0
    assert len(probe.odometry) - received + gone == len(stamps)
    assert probe.set('queue_depth', 50).successful


def test_poses_among_broken_clouds_are_those_without_them_bit_by_bit():
    report = check_fuzz(300, config=KISS)
    assert report.sound, report
    assert sum(report.dropped.values()) == report.sent == 300


def peak_mb(pid: int) -> float:
    """Largest resident memory of a process so far."""
    text = Path(f'/proc/{pid}/status').read_text(encoding='utf-8')
    found = re.search(r'VmHWM:\s*(\d+)', text)
    assert found is not None
    return int(found[1]) / 1024


def test_two_million_points_are_thinned_and_memory_is_bounded():
    settings: dict[str, Any] = {
        'decode_points': 100_000,
        'input_qos': 'reliable',
        'max_cloud_points': 4_000_000,
    }
    with running('large', **settings) as probe:
        probe.listen('static_points', PointCloud2)
        probe.listen('dynamic_points', PointCloud2)
        probe.wait(lambda: probe.publishers_matched('static_points', 'dynamic_points'), 'match')
        before = 0.0
        for k in range(4):
            huge = np.repeat(room(0.05 * k), 572, axis=0)[:2_000_000]
            s = stamp()
            assert probe.answer(cloud(huge, s)).pose.pose.position.x == pytest.approx(
                0.05 * k, abs=0.03
            )
            parts = [
                probe.wait(lambda t=topic, s=s: probe.at(s, t), topic)  # type: ignore[misc]
                for topic in ('static_points', 'dynamic_points')
            ]
            # In the first quarter of a second nothing is known to stand still.
            assert sum(p.width for p in parts) == (100_000 if k == 3 else 0)
            before = before or peak_mb(probe.process.pid)
        assert peak_mb(probe.process.pid) - before < 100.0
