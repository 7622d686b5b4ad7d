# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the node logs: through ROS, on one line, seldom."""

from __future__ import annotations

import logging
import threading
import warnings
from typing import Any

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from array import array

from rcl_interfaces.msg import Log
from ros_harness import STEP_NS, cloud, room, running

from hybridreg_ros.ros.journal import PERIOD_S, Journal
from hybridreg_ros.ros.qos import profile

pytestmark = pytest.mark.ros


class Logger:
    """Keeps lines with their level."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def warning(self, text: str) -> None:
        self.lines.append(f'W {text}')

    def info(self, text: str) -> None:
        self.lines.append(f'I {text}')

    def error(self, text: str) -> None:
        self.lines.append(f'E {text}')


@pytest.fixture
def journal():
    """An open journal; `seconds` is its clock, `lines` what it wrote."""
    logger, seconds = Logger(), [0.0]
    opened: Any = Journal(logger, lambda: seconds[0]).open()
    opened.lines, opened.seconds = logger.lines, seconds
    yield opened
    opened.shut()


def test_what_comes_too_often_is_counted(journal):
    for k in range(4):
        journal.warn('bad_cloud', str(k))
    journal.warn('lost', 'other')
    journal.seconds[0] = PERIOD_S
    journal.warn('bad_cloud', 'again')
    assert journal.lines == [
        'W bad_cloud: 0',
        'W lost: other',
        'W bad_cloud: again (and 3 more of this kind)',
    ]


def test_the_library_and_python_speak_through_it(journal, capfd):
    log = logging.getLogger('hybridreg_ros.odometry.frontend')
    for k in range(3):
        log.warning('new time base\nat %d s', k)
    warnings.warn('old way', DeprecationWarning, stacklevel=1)
    assert journal.lines[0] == 'W new time base at 0 s'
    assert len(journal.lines) == 2
    assert 'DeprecationWarning: old way' in journal.lines[1]
    assert capfd.readouterr().err == ''


def test_an_error_that_ends_a_thread_is_written_with_its_traceback(journal, capfd):
    thread = threading.Thread(target=lambda: 1 / 0)
    thread.start()
    thread.join()
    assert journal.lines[0].startswith('E internal error\nTraceback')
    assert 'ZeroDivisionError: division by zero' in journal.lines[0]
    assert capfd.readouterr().err == ''


def test_shut_gives_everything_back():
    before = threading.excepthook
    journal = Journal(Logger()).open()
    assert threading.excepthook != before
    journal.shut()
    assert threading.excepthook == before
    assert journal not in logging.getLogger('hybridreg_ros').handlers
    assert logging.getLogger('hybridreg_ros').propagate


def test_lines_of_a_node_are_on_rosout_one_of_a_kind():
    with running('journal') as probe:
        lines: list[str] = []
        probe.node.create_subscription(
            Log, '/rosout', lambda msg: lines.append(msg.msg), profile(True, 100, latched=True)
        )
        broken = cloud(room(), STEP_NS)
        broken.data = array('B', broken.data[:100])
        for _ in range(40):
            probe.send(broken)
        for k in range(1, 4):
            probe.answer(cloud(room(), k * STEP_NS))
        for k in range(11, 20):
            probe.send(cloud(room(), (1000 + k) * STEP_NS))
        probe.wait(lambda: any('new time base' in x for x in lines), 'a line of the front end')
        assert sum(x.startswith('bad_cloud: ') for x in lines) == 1
        assert not any('Warning' in x for x in lines), lines
        written = probe.process.log.read_text()
        assert all(x.startswith('[') for x in written.splitlines()), written
