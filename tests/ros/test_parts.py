# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The parts of the node that need no node: queue, transport, monitor, diagnostics."""

from __future__ import annotations

import threading
import time
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Header

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.result import OdometryResult, Reason, Source
from hybridreg_ros.ros import fastdds
from hybridreg_ros.ros.clouds.frame_queue import FrameQueue
from hybridreg_ros.ros.clouds.subscription import LossCounter
from hybridreg_ros.ros.conversions import to_pointcloud2, to_time
from hybridreg_ros.ros.diagnostics import Setting, of_frame, status
from hybridreg_ros.ros.monitor import Drop, Monitor
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.worker import Arrival, Worker

pytestmark = pytest.mark.ros

SETTING = Setting(
    name='hybridreg: odometry',
    hardware_id='/points',
    weights='packaged',
    has_weights=True,
    transport='shared memory',
    transport_warning=False,
    input_timeout_s=60.0,
    paused=False,
    starting='',
    waiting_for='',
    guides={},
    twins=0,
    queue=0,
    tf='on',
)


def result(source: Source, reason: Reason = Reason.OK, stamp: int = 10**9) -> OdometryResult:
    scan = Scan(np.zeros((2, 3), np.float32), stamp=stamp, size=5)
    return OdometryResult(
        scan=scan,
        pose=np.eye(4),
        covariance=np.eye(6),
        twist=np.zeros(6),
        twist_covariance=np.eye(6),
        source=source,
        reason=reason,
        confidence=0.75,
        dynamic_probability=np.zeros(2, np.float32),
        timings_s={'match': 0.02},
    )


def values(found: DiagnosticStatus) -> dict[str, str]:
    return {item.key: item.value for item in found.values}


class TestFrameQueue:
    def test_keeps_the_newest_in_order(self):
        queue = FrameQueue[int](2)
        assert [queue.put(k) for k in range(5)] == [0, 0, 1, 1, 1]
        assert [queue.get(), queue.get()] == [3, 4]

    def test_keeps_the_oldest_when_asked(self):
        queue = FrameQueue[int](2, keep_newest=False)
        assert [queue.put(k) for k in range(4)] == [0, 0, 1, 1]
        assert [queue.get(), queue.get()] == [0, 1]

    def test_shrinking_reports_what_goes(self):
        queue = FrameQueue[int](5)
        for k in range(5):
            queue.put(k)
        assert queue.configure(2, keep_newest=True) == 3
        assert [queue.get(), queue.get()] == [3, 4]

    @pytest.mark.parametrize(
        ('depth', 'left'), [(1, [4]), (2, [4]), (4, [3, 4]), (9, [0, 1, 2, 3, 4])]
    )
    def test_sheds_the_oldest_half(self, depth, left):
        queue = FrameQueue[int](depth)
        for k in range(5):
            queue.put(k)
        waiting = len(queue)
        assert queue.shed() == waiting - len(left)
        assert [queue.get() for _ in left] == left

    def test_close_wakes_the_reader_and_refuses(self):
        queue = FrameQueue[int](3)
        seen: list[int | None] = []
        thread = threading.Thread(target=lambda: seen.append(queue.get()))
        thread.start()
        assert queue.close() == 0
        thread.join(5.0)
        assert seen == [None]
        assert queue.put(1) == 1

    def test_no_item_is_lost_or_doubled_between_threads(self):
        queue = FrameQueue[int](7)
        seen: list[int] = []
        dropped = 0
        thread = threading.Thread(target=lambda: seen.extend(iter(queue.get, None)))
        thread.start()
        for k in range(5000):
            dropped += queue.put(k)
        dropped += queue.close()
        thread.join(5.0)
        assert len(seen) + dropped == 5000
        assert seen == sorted(set(seen))


class TestLossCounter:
    def test_gaps_and_events_tell_each_loss_once(self):
        told: list[int] = []
        counter = LossCounter(told.append)
        counter.arrived(5, lambda: True)  # joined late: nothing lost
        counter.arrived(6, lambda: True)
        counter.arrived(9, lambda: True)
        counter.event(2)  # the same two
        assert told == [2]
        counter.event(1)
        assert sum(told) == 3

    def test_a_new_publisher_or_several_are_no_loss(self):
        told: list[int] = []
        counter = LossCounter(told.append)
        counter.arrived(50, lambda: True)
        counter.arrived(1, lambda: True)
        counter.arrived(9, lambda: False)
        counter.restart()
        counter.arrived(90, lambda: True)
        counter.arrived(None, lambda: True)
        assert told == []


class TestFastDds:
    def test_profile_is_set_for_both_names_of_the_variable(self):
        env: dict[str, str] = {}
        found = fastdds.prepare(env)
        assert found.profile == fastdds.PROFILE
        assert set(env.values()) == {str(fastdds.PROFILE)}
        assert not found.warning

    def test_profile_has_a_segment_of_64_mib_and_udp(self):
        name = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'
        root = ElementTree.parse(fastdds.PROFILE).getroot()
        segment = int(root.findtext(f'.//{name}segment_size', ''))
        assert segment >= 64 << 20
        assert int(root.findtext(f'.//{name}maxMessageSize', '')) <= segment
        assert [t.text for t in root.iter(f'{name}type')] == ['SHM', 'UDPv4']

    @pytest.mark.parametrize(
        ('env', 'text', 'warning'),
        [
            ({'FASTRTPS_DEFAULT_PROFILES_FILE': '/my.xml'}, 'of the environment: /my.xml', False),
            ({'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp'}, 'rmw_cyclonedds_cpp brings', False),
            ({'HYBRIDREG_FASTDDS': 'off'}, 'HYBRIDREG_FASTDDS=off', True),
        ],
    )
    def test_the_users_choice_stands(self, env, text, warning):
        before = dict(env)
        found = fastdds.prepare(env)
        assert text in found.reason
        assert found.warning is warning
        assert env == before

    def test_small_shared_memory_gives_a_smaller_segment(self, monkeypatch):
        monkeypatch.setattr(fastdds, '_free_mib', lambda _: 64)
        env: dict[str, str] = {}
        found = fastdds.prepare(env)
        assert found.profile is not None
        text = found.profile.read_text()
        assert '<segment_size>16777216<' in text
        assert '<maxMessageSize>4194304<' in text
        assert 'segment of 16 MiB' in found.reason

    def test_no_shared_memory_is_a_loud_fallback(self, tmp_path):
        env: dict[str, str] = {}
        found = fastdds.prepare(env, tmp_path / 'nowhere')
        assert found.warning
        assert 'large clouds may be lost' in found.reason
        assert '0 MiB free, expected at least 48' in found.reason
        assert not env


class TestDiagnostics:
    def test_ok(self):
        monitor = Monitor()
        monitor.processed(result(Source.HYBRIDREG), monitor.arrived())
        found = status(monitor.snapshot(), SETTING)
        assert (found.level, found.message) == (DiagnosticStatus.OK, 'ok')
        told = values(found)
        assert told['source'] == 'hybridreg'
        assert told['confidence'] == '0.750000'
        assert (told['received'], told['processed'], told['dropped']) == ('1', '1', '0')
        assert told['invalid_points'] == '3'
        assert told['match_ms'] == '20.000'

    def test_switches_are_told_with_their_reason(self):
        monitor = Monitor()
        assert monitor.processed(result(Source.HYBRIDREG), 0.0) == ''
        line = monitor.processed(
            result(Source.KISS_ICP, Reason.LOW_CONFIDENCE, 2 * 10**9), monitor.arrived()
        )
        assert line == 'hybridreg to kiss_icp at 2.000 s: low_confidence, confidence 0.75'
        found = status(monitor.snapshot(), SETTING)
        assert values(found)['last_switch'] == line
        assert found.level == DiagnosticStatus.OK  # one of two ways, and no fault

    def test_lost_is_an_error(self):
        monitor = Monitor()
        monitor.processed(result(Source.LOST, Reason.NO_OVERLAP), monitor.arrived())
        found = status(monitor.snapshot(), SETTING)
        assert found.level == DiagnosticStatus.ERROR
        assert found.message.startswith('lost: no_overlap')

    def test_a_direction_that_nothing_holds_is_named(self):
        monitor, weak = Monitor(), np.array([0.6, 0.0, -0.8])
        turned = se3.transform(se3.so3_exp(np.array([0.0, 0.0, np.pi / 2.0])), np.zeros(3))
        held = replace(result(Source.HYBRIDREG), pose=turned)
        for direction, level, text in [
            (weak, DiagnosticStatus.WARN, '0.00 -0.60 -0.80'),
            (None, DiagnosticStatus.OK, 'none'),
        ]:
            last = replace(held, weak_direction=direction)
            monitor.processed(last, monitor.arrived())
            found = status(monitor.snapshot(), SETTING)
            assert (found.level, values(found)['weak_direction']) == (level, text)
            frame = of_frame(last, 'hybridreg', to_time(10**9)).status[0]
            assert values(frame)['weak_direction'] == text

    def test_a_new_map_warns_for_good(self):
        monitor = Monitor()
        for reason in (Reason.RECOVERED, Reason.OK):
            last = replace(result(Source.HYBRIDREG, reason), adrift=True)
            monitor.processed(last, monitor.arrived())
            found = status(monitor.snapshot(), SETTING)
            assert found.level == DiagnosticStatus.WARN
            assert 'a new map has begun' in found.message

    def test_drops_warn_once_and_stay_counted(self):
        monitor = Monitor()
        monitor.processed(result(Source.HYBRIDREG), monitor.arrived())
        monitor.dropped(Drop.QUEUE_FULL, 'too fast', 3)
        found = status(monitor.snapshot(), SETTING)
        assert found.level == DiagnosticStatus.WARN
        assert 'clouds dropped: 3 queue_full; last: queue_full: too fast' in found.message
        later = status(monitor.snapshot(), SETTING)
        assert later.level == DiagnosticStatus.OK
        assert values(later)['dropped.queue_full'] == '3'

    def test_only_bad_clouds_are_an_error(self):
        monitor = Monitor()
        monitor.arrived()
        monitor.dropped(Drop.BAD_CLOUD, 'lacks field x')
        assert status(monitor.snapshot(), SETTING).level == DiagnosticStatus.ERROR

    @pytest.mark.parametrize(
        ('change', 'text'),
        [
            (
                {'has_weights': False, 'weights': 'none yet'},
                'no weights, kiss-icp alone: none yet',
            ),
            ({'paused': True}, 'paused'),
            ({'input_timeout_s': -1.0}, 'no cloud for'),
            ({'waiting_for': 'no extrinsic'}, 'no extrinsic'),
            ({'transport_warning': True}, 'shared memory'),
        ],
    )
    def test_settings_that_warn(self, change, text):
        monitor = Monitor()
        monitor.processed(result(Source.HYBRIDREG), monitor.arrived())
        found = status(monitor.snapshot(), replace(SETTING, **change))
        assert found.level == DiagnosticStatus.WARN
        assert text in found.message


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        ({'extrinsic': (0.0,) * 7}, 'expected a unit quaternion, found norm 0'),
        ({'extrinsic': (1.0,)}, 'expected 7 numbers'),
        ({'odom_frame': ''}, 'odom_frame: expected a frame name'),
        ({'base_frame': '/base'}, 'expected a frame without leading /'),
        ({'base_frame': 'odom'}, 'expected a frame other than odom_frame'),
        ({'queue_depth': 0}, 'queue_depth: expected >= 1, found 0'),
    ],
)
def test_node_config_refuses(change, text):
    with pytest.raises(ConfigError, match=text):
        NodeConfig(**change)


class _Stumbling(HybridOdometry):
    """The real front end with a bug in its second step."""

    def locate(self, scan, *rest):
        if scan.stamp == 2 * 10**8:
            raise ZeroDivisionError('a bug')
        return super().locate(scan, *rest)


class _Behind(HybridOdometry):
    """The real front end, so far behind that it wants the newest, held up in its first step."""

    wants_newest = True
    entered, go_on = threading.Event(), threading.Event()

    def locate(self, scan, *rest):
        self.entered.set()
        self.go_on.wait(20.0)
        return super().locate(scan, *rest)


def run_worker(front_end, config, monitor, until, feed):
    """Stamps, 0.1 s, of poses and of published clouds, until so many were published."""
    posed, published = [], []
    worker = Worker(
        front_end,
        config,
        monitor,
        lambda _: None,
        lambda result: posed.append(result.stamp // 10**8),
        lambda _, result: published.append(result.stamp // 10**8),
        lambda *_: None,
    )
    worker.start()
    points = np.random.default_rng(0).uniform(-5, 5, (3000, 3)).astype(np.float32)

    def submit(k):
        header = Header(stamp=to_time(k * 10**8), frame_id='lidar')
        worker.submit(Arrival(to_pointcloud2(from_arrays(points), header), monitor.arrived()))

    feed(submit)
    end = time.monotonic() + 20.0
    while len(published) < until and time.monotonic() < end:
        time.sleep(0.01)
    worker.stop()
    return posed, published


def test_far_behind_the_newest_comes_next_and_the_others_are_counted():
    monitor, config = Monitor(), NodeConfig(queue_depth=4)
    front_end = _Behind(OdometryConfig(registrar='kiss-icp'), model=None)

    def feed(submit):
        submit(1)
        assert front_end.entered.wait(20.0)
        for k in range(2, 7):
            submit(k)
        front_end.go_on.set()

    posed, published = run_worker(front_end, config, monitor, 3, feed)
    assert posed == published == [1, 5, 6]
    assert values(status(monitor.snapshot(), SETTING))['dropped.queue_full'] == '3'


@pytest.mark.filterwarnings('ignore::pytest.PytestUnhandledThreadExceptionWarning')
def test_a_bug_costs_one_cloud_and_is_an_error():
    monitor = Monitor()
    front_end = _Stumbling(OdometryConfig(registrar='kiss-icp'), model=None)
    posed, published = run_worker(
        front_end,
        NodeConfig(queue_depth=10),
        monitor,
        2,
        lambda submit: [submit(k) for k in (1, 2, 3)],
    )
    assert posed == published == [1, 3]
    found = status(monitor.snapshot(), SETTING)
    assert found.level == DiagnosticStatus.ERROR
    assert values(found)['dropped.internal_error'] == '1'
