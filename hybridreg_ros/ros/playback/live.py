# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A bag through the real node over real DDS: every cloud in order, every output collected."""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import PointCloud2

from hybridreg_ros.core.errors import ConfigError, HybridRegError
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros import fastdds
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.playback.flow import Flow
from hybridreg_ros.ros.playback.node_process import LOCALHOST, NodeProcess
from hybridreg_ros.ros.playback.player import Player, PlayOptions, PlayReport
from hybridreg_ros.ros.playback.playing import open_bag, spinning
from hybridreg_ros.ros.qos import profile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from nav_msgs.msg import Odometry
    from rclpy.node import Node

_QUEUE = 4
_START_S = 180.0


@dataclass(frozen=True)
class LiveReport:
    """What went into the node and what came out.

    Attributes:
        sent: clouds published.
        received_odom: Odometry messages that came back.
        received_dynamic: dynamic clouds that came back; 0 when nobody asked for them.
        received_static: static clouds that came back; 0 when nobody asked for them.
        received_frames: reports per frame that came back; 0 when nobody asked for them.
        dropped: clouds that the node dropped, by cause.
        seconds: wall time from the first cloud to the last output.
        diagnostics: last message of the node's diagnostics.
    """

    sent: int
    received_odom: int
    received_dynamic: int
    received_static: int
    received_frames: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    diagnostics: str = ''

    @property
    def missing(self) -> int:
        """Clouds that are neither odometry nor a counted drop; 0 after a sound run."""
        return self.sent - self.received_odom - sum(self.dropped.values())


class _Counter:
    """Counts messages and hands them on."""

    def __init__(self, forward: Callable[[Any], None] | None) -> None:
        self.count = 0
        self.wanted = forward is not None
        self._forward = forward

    def __call__(self, msg: Any) -> None:
        if self._forward is not None:
            self._forward(msg)
        self.count += 1


def run_live(  # noqa: PLR0913 - four outputs, each optional
    bag_path: str | Path,
    topic: str | None,
    config: OdometryConfig | None = None,
    on_odom: Callable[[Odometry], None] | None = None,
    on_dynamic: Callable[[PointCloud2], None] | None = None,
    on_static: Callable[[PointCloud2], None] | None = None,
    on_frame: Callable[[DiagnosticArray], None] | None = None,
    *,
    node_config: NodeConfig | None = None,
    rate: float = 0.0,
    domain_id: int | None = None,
    timeout_s: float = 60.0,
) -> LiveReport:
    """Start the node, play the bag into it without loss, and collect what it publishes.

    The node runs in its own process, domain and namespace. A cloud is sent when the node has room
    for it, so every cloud is processed in order and the poses equal those of an offline run.

    Args:
        bag_path: rosbag2 file or directory.
        topic: PointCloud2 topic of the bag; None takes the only one.
        config: settings of the front end.
        on_odom: receives each Odometry message, in another thread; so do the next three.
        on_dynamic: receives each cloud of dynamic points; None = not published at all.
        on_static: receives each cloud of static points; None = not published at all.
        on_frame: receives what each frame says about itself; None = not published at all.
        node_config: settings of the node; queue and QoS are set here.
        rate: speed, 1 = as recorded; 0 = as fast as the node can.
        domain_id: ROS domain, default one derived from the process id.
        timeout_s: longest silence of the node before the run is given up.

    Raises:
        BagError: the bag cannot be read or lacks the topic.
        HybridRegError: the node did not start, ended, or went silent.
    """
    if not rate >= 0.0:
        raise ConfigError(f'rate: expected >= 0, found {rate}')
    domain = 1 + os.getpid() % 99 if domain_id is None else domain_id
    space = f'/live_{os.getpid()}_{time.monotonic_ns() % 1_000_000}'
    base = node_config or NodeConfig()
    settings = replace(
        base,
        input_qos='reliable',
        input_qos_depth=100,
        queue_depth=2 * _QUEUE,
        diagnostics_period_s=0.1,
        publish_tf=False,
    )
    counters = tuple(_Counter(taker) for taker in (on_odom, on_dynamic, on_static, on_frame))
    with contextlib.closing(open_bag(bag_path)) as bag:
        name = bag.cloud_topic(topic)
        node_process = NodeProcess((config or OdometryConfig(), settings), space, domain)
        with node_process as process, own_node(space, domain) as node:
            return _drive(node, process, bag, name, rate, counters, timeout_s)


@contextlib.contextmanager
def own_node(namespace: str, domain_id: int) -> Iterator[Node]:
    """Node for one run that leaves the caller's ROS state and signal handlers alone."""
    before = {key: os.environ.get(key) for key in LOCALHOST}
    fastdds.prepare()
    os.environ.update(LOCALHOST)
    context = rclpy.context.Context()
    try:
        context.init(domain_id=domain_id)
        node = rclpy.create_node(
            'live', context=context, namespace=namespace, use_global_arguments=False
        )
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()
        for key, value in before.items():
            os.environ.pop(key) if value is None else os.environ.update({key: value})


def _drive(
    node: Node,
    process: NodeProcess,
    bag: Any,
    topic: str,
    rate: float,
    counters: tuple[_Counter, ...],
    timeout_s: float,
) -> LiveReport:
    odom, dynamic, static, frame = counters
    kept = profile(reliable=True, depth=100)
    for counter, output, kind in (
        (dynamic, 'dynamic_points', PointCloud2),
        (static, 'static_points', PointCloud2),
        (frame, 'frame', DiagnosticArray),
    ):
        if counter.wanted:
            node.create_subscription(kind, f'hybridreg/{output}', counter, kept)
    flow = Flow(node, 'hybridreg', _QUEUE, odom)  # its diagnostics come last: all else is matched
    options = PlayOptions(topics=(topic,), rate=rate, depth=2 * _QUEUE, names={topic: 'points'})
    player = Player(node, bag, options)
    with spinning(node):
        process.wait_until(
            lambda: flow.seen and player.heard,
            max(_START_S, timeout_s),
            'the node to subscribe',
        )
        began = time.monotonic()
        report = player.play(PlayReport(), _Patience(flow, process, timeout_s).may_send)
        process.wait_until(lambda: flow.under_way <= 0, timeout_s, 'the last clouds')
        expected = report.clouds - sum(flow.dropped.values())
        wanted = [odom, *(c for c in (dynamic, static, frame) if c.wanted)]
        process.wait_until(
            lambda: all(c.count >= expected for c in wanted), timeout_s, 'the last outputs'
        )
        return LiveReport(
            sent=report.clouds,
            received_odom=odom.count,
            received_dynamic=dynamic.count,
            received_static=static.count,
            received_frames=frame.count,
            dropped=dict(flow.dropped),
            seconds=time.monotonic() - began,
            diagnostics=flow.message,
        )


class _Patience:
    """Flow control that gives up when the node ends or stays silent for too long."""

    def __init__(self, flow: Flow, process: NodeProcess, timeout_s: float) -> None:
        self._flow, self._process, self._timeout_s = flow, process, timeout_s
        self._last = (0, time.monotonic())

    def may_send(self, stamp: int) -> bool:
        """As Flow.may_send.

        Raises:
            HybridRegError: the node ended or went silent.
        """
        if self._flow.may_send(stamp):
            return True
        self._process.check()
        now, done = time.monotonic(), -self._flow.under_way + self._flow.sent
        if done != self._last[0]:
            self._last = (done, now)
        if now - self._last[1] > self._timeout_s:
            raise HybridRegError(
                f'the node has been silent for {self._timeout_s:g} s with '
                f'{self._flow.under_way} clouds in progress; its last line: '
                f'{self._process.last_line()}'
            )
        return False
