# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Gyro: how the sensor has turned, by the angular rate of an IMU; nothing else of it is used."""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from sensor_msgs.msg import Imu

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import DependencyError
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.ros.conversions import to_ns
from hybridreg_ros.ros.qos import profile
from hybridreg_ros.ros.topics import IMU
from hybridreg_ros.ros.transforms import StaticListener

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rclpy.node import Node

    F64 = NDArray[np.float64]

_KEPT = 4000
_WAIT_S = 0.05
"""How long a step waits for rates that have not come yet."""
_GAP_NS = 50_000_000
"""Without a rate for so long, or at the ends of an interval, the turn is not known."""
_FASTEST = 100.0
"""Rates above this, rad/s, are broken."""


class Gyro:
    """Turn and mean rate of the sensor between two instants; a guide of GuidedMotion.

    Attributes:
        sensor_frame: frame of the clouds.
        state: 'used', or why constant velocity is used instead.
    """

    def __init__(self, node: Node) -> None:
        """Subscribe to `imu`, sensor data QoS, and to /tf_static."""
        self.sensor_frame = ''
        self.state = 'waiting for two clouds'
        self._frame = ''
        self._rates: deque[tuple[int, F64]] = deque(maxlen=_KEPT)
        self._changed = threading.Condition()
        try:
            self._static: StaticListener | None = StaticListener(node)
        except DependencyError:
            self._static = None
        self._subscription = node.create_subscription(
            Imu, IMU.name, self._on_message, profile(False, IMU.depth)
        )

    def _on_message(self, msg: Imu) -> None:
        w, stamp = msg.angular_velocity, to_ns(msg.header.stamp)
        rate = np.array([w.x, w.y, w.z])
        if not np.abs(rate).max() < _FASTEST:
            return
        with self._changed:
            if self._rates and stamp <= self._rates[-1][0]:
                if stamp == self._rates[-1][0]:
                    return
                self._rates.clear()  # another time base
            self._frame = msg.header.frame_id.lstrip('/')
            self._rates.append((stamp, rate))
            self._changed.notify_all()

    def __call__(self, since: int, until: int, steady: F64) -> F64:
        """`steady`, a motion (4, 4) between two instants, ns, with the turn that was measured."""
        found = self._between(since, until, _WAIT_S)
        if found is None:
            return steady
        stamps, rates = found
        R = np.eye(3)
        for step_s, rate in zip(np.diff(stamps) / NS_PER_S, _middles(rates), strict=True):
            R = R @ se3.so3_exp(rate * step_s)
        return se3.transform(R, steady[:3, 3])

    def rate(self, since: int, until: int) -> F64 | None:
        """Mean rate (3,), sensor frame, rad/s, between two instants, ns; None = unknown."""
        found = self._between(since, until, _WAIT_S)
        if found is None:
            return None
        stamps, rates = found
        weights = np.diff(stamps).astype(np.float64)
        mean: F64 = np.average(_middles(rates), axis=0, weights=weights)
        return mean

    def _between(
        self, since: int, until: int, wait_s: float
    ) -> tuple[NDArray[np.int64], F64] | None:
        """Instants (N,), the two given at the ends, and rates (N, 3) there, sensor frame."""
        with self._changed:
            self._changed.wait_for(lambda: self._rates and self._rates[-1][0] >= until, wait_s)
            kept, frame = list(self._rates), self._frame
        T = self._extrinsic(frame)
        if T is None:
            self.state = f'no transform from {self.sensor_frame} to {frame} on /tf_static'
            return None
        stamps = np.array([s for s, _ in kept if since < s < until], np.int64)
        stamps = np.concatenate([[since], stamps, [until]])
        outside = not kept or kept[0][0] > since + _GAP_NS or kept[-1][0] < until - _GAP_NS
        if outside or until <= since or np.diff(stamps).max() > _GAP_NS:
            self.state = 'no angular rates on imu at the time'
            return None
        known = np.array([s for s, _ in kept], np.int64)
        rates = np.array([r for _, r in kept]) @ T[:3, :3].T
        at = (stamps - since).astype(np.float64)
        there = (known - since).astype(np.float64)
        self.state = 'used'
        return stamps, np.stack([np.interp(at, there, column) for column in rates.T], axis=1)

    def _extrinsic(self, frame: str) -> F64 | None:
        """Pose of the IMU in the sensor frame, of which the turn counts; None = unknown."""
        if frame in ('', self.sensor_frame):
            return np.eye(4)
        return None if self._static is None else self._static.lookup(self.sensor_frame, frame)


def _middles(rates: F64) -> F64:
    middles: F64 = 0.5 * (rates[1:] + rates[:-1])
    return middles
