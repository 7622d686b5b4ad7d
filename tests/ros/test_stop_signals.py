# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM end the executables with 0 and without a word, whenever they come."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from diagnostic_msgs.msg import DiagnosticStatus
from ros_harness import KISS, QUICK, STEP_NS, Probe, cloud, domain, room, running

from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros.playback.node_process import LOCALHOST, NodeProcess, waits_for_signals
from hybridreg_ros.ros.stop_signals import StopSignals

pytestmark = pytest.mark.ros

BOTH = (signal.SIGINT, signal.SIGTERM)
HANG_S = 30.0
_HEAD = 'import signal, sys, time\nfrom hybridreg_ros.ros.stop_signals import StopSignals, leave\n'


def busy(text: str) -> subprocess.Popen[str]:
    """A process that runs a program with the signals waited for, once it said that it is there."""
    process = subprocess.Popen(
        [sys.executable, '-c', _HEAD + text],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == 'there\n'
    return process


def end(process: subprocess.Popen[str], *signals: signal.Signals) -> tuple[int, str]:
    """Exit code and output after signals 50 ms apart."""
    for number in signals:
        process.send_signal(number)
        time.sleep(0.05)
    output, _ = process.communicate(timeout=HANG_S)
    return process.returncode, output


@pytest.mark.parametrize('signals', [BOTH[:1], BOTH[1:], BOTH, BOTH[:1] * 2], ids=str)
@pytest.mark.parametrize('call', ['time.sleep(100)', '[0 for _ in iter(int, 1)]'])
def test_a_long_call_is_left(call, signals):
    before = f'with StopSignals() as stop:\n print("there", flush=True)\n {call}'
    assert end(busy(before), *signals) == (0, '')
    order = before.replace(' print', ' stop.end_in_order(lambda: None)\n print')
    assert end(busy(order), *signals) == (0, '')


def test_an_orderly_end_is_waited_for_and_a_second_signal_does_not_disturb_it():
    process = busy(
        'import threading\nasked = threading.Event()\n'
        'with StopSignals() as stop:\n stop.end_in_order(asked.set)\n print("there", flush=True)\n'
        ' asked.wait()\n time.sleep(0.3)\n print("orderly")\nleave(0 if stop.asked else 1)'
    )
    assert end(process, *BOTH) == (0, 'orderly\n')


def test_a_process_in_the_background_of_a_script_ends_too():
    code = _HEAD + 'with StopSignals():\n print("there", flush=True)\n time.sleep(100)'
    script = '"$0" -c "$1" & sleep 2; kill -INT $!; wait $!; echo $?'
    done = subprocess.run(
        ['sh', '-c', script, sys.executable, code],
        capture_output=True,
        text=True,
        timeout=HANG_S,
        check=False,
    )
    assert (done.stdout, done.stderr) == ('there\n0\n', '')


def test_without_a_signal_the_signals_are_as_before():
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    with StopSignals() as stop:
        assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) >= set(BOTH)
    assert not stop.asked
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


@pytest.mark.parametrize('signals', [BOTH[:1], BOTH[1:] * 2], ids=str)
@pytest.mark.parametrize('delay_s', [0.0, 0.3, 1.0])
def test_while_the_node_loads(delay_s, signals):
    process = subprocess.Popen(
        [sys.executable, '-m', 'hybridreg_ros.ros.odometry_node'],
        env={**os.environ, **LOCALHOST, 'ROS_DOMAIN_ID': str(domain())},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    while not waits_for_signals(process.pid):
        time.sleep(0.001)
    time.sleep(delay_s)
    code, output = end(process, *signals)
    assert (code, 'Traceback' in output) == (0, False), output


def test_while_kernels_are_compiled_which_diagnostics_say(tmp_path):
    probe = Probe('/cold')
    with NodeProcess(
        (OdometryConfig(), QUICK), '/cold', domain(), {'NUMBA_CACHE_DIR': str(tmp_path)}
    ) as process:
        process.wait_until(lambda: 'compiling: kiss-icp' in probe.text, HANG_S, 'the compiler')
        assert 'starting, no cloud is taken yet' in probe.text
        assert probe.level == DiagnosticStatus.WARN
        probe.close()
        assert process.stop(HANG_S) == 0
        assert 'Traceback' not in process.log.read_text()


@pytest.mark.parametrize('signals', [BOTH[:1], BOTH[1:] * 2], ids=str)
def test_while_a_cloud_is_registered(signals):
    with running('long', config=KISS, queue_depth=50) as probe:
        points = np.tile(room(), (40, 1))
        for k in range(1, 20):
            probe.send(cloud(points, k * STEP_NS))
        probe.wait(lambda: probe.odometry, 'odometry')
        for number in signals:
            os.kill(probe.process.pid, number)
            time.sleep(0.05)
        assert probe.process.ended(HANG_S) == 0
        assert 'Traceback' not in probe.process.log.read_text()


def test_under_a_flood_of_clouds_with_every_output_heard():
    with running('stop', queue_depth=3) as probe:
        stopped, points = threading.Event(), room()

        def flood() -> None:
            for k in range(1, 10_000):
                if stopped.wait(0.002):
                    return
                probe.send(cloud(points, k * 1_000_000))

        thread = threading.Thread(target=flood)
        thread.start()
        probe.wait(lambda: len(probe.odometry) > 5, 'odometry')
        code = probe.process.stop()
        stopped.set()
        thread.join()
        log = probe.process.log.read_text()
        assert code == 0, log
        assert 'Traceback' not in log
        assert 'rror' not in log, log
