# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The managed node over DDS: every transition, twice round, and what it keeps."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from ros_harness import KISS, QUICK, STEP_NS, Probe, cloud, domain, room

from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros.conversions import from_pose
from hybridreg_ros.ros.playback.node_process import NodeProcess

pytestmark = pytest.mark.ros


class Manager:
    """Client of the lifecycle services of one node."""

    def __init__(self, probe: Probe) -> None:
        self._probe = probe
        self._change = probe.node.create_client(ChangeState, 'hybridreg/change_state')
        self._get = probe.node.create_client(GetState, 'hybridreg/get_state')
        assert self._change.wait_for_service(60.0)
        assert self._get.wait_for_service(60.0)

    def to(self, transition: int) -> bool:
        """Ask for a transition; whether it succeeded."""
        future = self._change.call_async(ChangeState.Request(transition=Transition(id=transition)))
        self._probe.wait(future.done, f'transition {transition}', 120.0)
        return bool(future.result().success)

    @property
    def state(self) -> int:
        """Present state."""
        future = self._get.call_async(GetState.Request())
        self._probe.wait(future.done, 'the state')
        return int(future.result().current_state.id)


def managed(name: str, **changes) -> tuple[NodeProcess, str]:
    """Process and namespace of a managed node."""
    space = f'/managed_{name}_{os.getpid()}'
    config = changes.pop('config', KISS)
    settings = replace(QUICK, **changes)
    return NodeProcess((config, settings), space, domain(), managed=True), space


def x_of(msg: Any) -> float:
    """Position along x."""
    return float(from_pose(msg.pose.pose)[0, 3])


def test_every_transition_twice_round():
    process, space = managed('round')
    with process:
        probe = Probe(space)
        manager = Manager(probe)
        assert manager.state == State.PRIMARY_STATE_UNCONFIGURED
        odom = probe.node.resolve_topic_name('hybridreg/odom')
        assert probe.node.count_publishers(odom) == 0
        stamp = 0
        for _ in range(2):
            assert manager.to(Transition.TRANSITION_CONFIGURE)
            assert manager.state == State.PRIMARY_STATE_INACTIVE
            probe.wait(lambda: probe.text.endswith('no cloud is taken yet: inactive'), 'its word')
            assert probe.points.get_subscription_count() == 0
            assert manager.to(Transition.TRANSITION_ACTIVATE)
            probe.wait(probe.points.get_subscription_count, 'the subscription')
            for k in range(3):
                stamp += STEP_NS
                msg = probe.answer(cloud(room(0.1 * k), stamp))
                np.testing.assert_allclose(x_of(msg), 0.1 * k, atol=0.03)
            assert manager.to(Transition.TRANSITION_DEACTIVATE)
            probe.wait(lambda: probe.points.get_subscription_count() == 0, 'the end of it')
            assert manager.to(Transition.TRANSITION_ACTIVATE)  # pose and map were kept
            probe.wait(probe.points.get_subscription_count, 'the subscription')
            stamp += STEP_NS
            np.testing.assert_allclose(x_of(probe.answer(cloud(room(0.3), stamp))), 0.3, atol=0.03)
            assert manager.to(Transition.TRANSITION_DEACTIVATE)
            assert manager.to(Transition.TRANSITION_CLEANUP)
            assert manager.state == State.PRIMARY_STATE_UNCONFIGURED
            probe.wait(lambda: probe.node.count_publishers(odom) == 0, 'the end of its topics')
        assert manager.to(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
        assert manager.state == State.PRIMARY_STATE_FINALIZED
        probe.close()
        assert process.stop() == 0
        assert 'Traceback' not in process.log.read_text()


def test_what_cannot_be_configured_is_one_line_and_can_be_shut_down():
    process, space = managed('broken', config=OdometryConfig(), weights='/nowhere/w.safetensors')
    with process:
        probe = Probe(space)
        manager = Manager(probe)
        assert not manager.to(Transition.TRANSITION_CONFIGURE)
        assert manager.state == State.PRIMARY_STATE_UNCONFIGURED
        assert 'not configured: ' in process.last_line()
        assert '/nowhere/w.safetensors' in process.last_line()
        assert manager.to(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
        probe.close()
        assert process.stop() == 0


def test_shutdown_while_active_is_in_order():
    process, space = managed('active')
    with process:
        probe = Probe(space)
        manager = Manager(probe)
        assert manager.to(Transition.TRANSITION_CONFIGURE)
        assert manager.to(Transition.TRANSITION_ACTIVATE)
        probe.wait(probe.points.get_subscription_count, 'the subscription')
        probe.answer(cloud(room(), STEP_NS))
        assert manager.to(Transition.TRANSITION_ACTIVE_SHUTDOWN)
        assert manager.state == State.PRIMARY_STATE_FINALIZED
        assert probe.points.get_subscription_count() == 0
        probe.close()
        assert process.stop() == 0
