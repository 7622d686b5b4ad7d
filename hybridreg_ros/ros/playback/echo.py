# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Echo: what an odometry node publishes, as lines to read, without the ros2 command."""

from __future__ import annotations

import math
import re
import time
from typing import TYPE_CHECKING

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor

from hybridreg_ros.core.errors import HybridRegError
from hybridreg_ros.odometry.result import LOST_VARIANCE
from hybridreg_ros.ros import fastdds
from hybridreg_ros.ros.conversions import from_pose
from hybridreg_ros.ros.qos import profile

if TYPE_CHECKING:
    from collections.abc import Callable

_LOOK_S = 0.2
_NUMBER = re.compile(r'[\d.]+')


def line(msg: Odometry) -> str:
    """An Odometry message on one line: stamp, position, yaw, speed, standard deviation."""
    T, v = from_pose(msg.pose.pose), msg.twist.twist.linear
    yaw_deg = math.degrees(math.atan2(T[1, 0], T[0, 0]))
    variances = np.diag(np.array(msg.pose.covariance).reshape(6, 6))
    stamp_s = msg.header.stamp.sec + 1e-9 * msg.header.stamp.nanosec
    x, y, z = T[:3, 3]
    text = f'{stamp_s:.3f} s  x {x:.3f}  y {y:.3f}  z {z:.3f} m  yaw {yaw_deg:.1f} deg'
    if variances.max() >= LOST_VARIANCE:
        return f'{text}  lost: not to be used'
    sigma_mm = 1e3 * math.sqrt(max(variances[:3].max(), 0.0))
    return f'{text}  {math.hypot(v.x, v.y, v.z):.2f} m/s  +-{sigma_mm:.1f} mm'


class _Listener:
    """Counts what comes and says it."""

    def __init__(
        self, name: str, say: Callable[[str], object], remark: Callable[[str], object]
    ) -> None:
        self._status, self._say, self._remark = f'{name}: odometry', say, remark
        self._kind = ''
        self.shown = 0
        self.heard_s = time.monotonic()

    def on_odometry(self, msg: Odometry) -> None:
        self.heard_s = time.monotonic()
        self.shown += 1
        self._say(line(msg))

    def on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            if status.name != self._status:
                continue
            kind = _NUMBER.sub('', status.message)  # seconds and counts go on
            if kind != self._kind and status.level != DiagnosticStatus.OK:
                self._remark(status.message)
            self._kind = kind


def echo(
    say: Callable[[str], object],
    remark: Callable[[str], object],
    node: str = 'hybridreg',
    count: int = 0,
    wait_s: float = 0.0,
) -> int:
    """Say the Odometry messages of a node, one by one.

    Args:
        say: receives a line for each message.
        remark: receives what the diagnostics of the node find, when that changes.
        node: name of the node, with its namespace.
        count: messages after which it ends; 0 = never.
        wait_s: longest silence; 0 = any.

    Returns:
        How many messages came.

    Raises:
        HybridRegError: nothing came for `wait_s`.
    """
    name = node.lstrip('/')
    topic, listener = f'/{name}/odom', _Listener(name, say, remark)
    fastdds.prepare()
    context = rclpy.context.Context()
    context.init()
    try:
        own = rclpy.create_node('hybridreg_echo', context=context)
        own.create_subscription(Odometry, topic, listener.on_odometry, profile(True, 100))
        own.create_subscription(
            DiagnosticArray, '/diagnostics', listener.on_diagnostics, profile(True, 10)
        )
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(own)
        while not count or listener.shown < count:
            executor.spin_once(timeout_sec=_LOOK_S)
            if wait_s and time.monotonic() - listener.heard_s > wait_s:
                there = own.count_publishers(topic)
                state = 'its node runs' if there else 'no node publishes it'
                raise HybridRegError(f'nothing on {topic} for {wait_s:g} s: {state}')
    finally:
        context.try_shutdown()
    return listener.shown
