# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Gyro: how the sensor has turned, by the angular rates of an IMU, and where up is, at rest."""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

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
_REST_NS = 1_000_000_000
"""Over so long accelerations are averaged: MEMS noise is then far below a tenth of a degree."""
_SLOWEST = 0.05
"""Mean rate, rad/s, above which it turns; an IMU at rest shows its bias, up to 0.02."""
_EVEN = 0.05
"""How far, as a share of gravity, accelerations at rest may be from it and scatter: bias, noise
and the vibration of engines."""
_GRAVITY = (9.81, 1.0)
"""In m/s^2, or in g as some drivers have it; only the direction is used."""


class _Sample(NamedTuple):
    stamp: int
    rate: F64
    force: F64


class Gyro:
    """Turn and mean rate of the sensor between two instants; a guide of GuidedMotion.

    Attributes:
        sensor_frame: frame of the clouds.
        state: 'used', or why constant velocity is used instead.
        level: whether the first pose was levelled, or why not.
    """

    def __init__(self, node: Node) -> None:
        """Subscribe to `imu`, sensor data QoS, and to /tf_static."""
        self.sensor_frame = ''
        self.state = 'waiting for two clouds'
        self.level = 'waiting for a cloud'
        self._frame = ''
        self._samples: deque[_Sample] = deque(maxlen=_KEPT)
        self._changed = threading.Condition()
        try:
            self._static: StaticListener | None = StaticListener(node)
        except DependencyError:
            self._static = None
        self._subscription = node.create_subscription(
            Imu, IMU.name, self._on_message, profile(False, IMU.depth)
        )

    def _on_message(self, msg: Imu) -> None:
        w, a, stamp = msg.angular_velocity, msg.linear_acceleration, to_ns(msg.header.stamp)
        rate = np.array([w.x, w.y, w.z])
        if not np.abs(rate).max() < _FASTEST:
            return
        with self._changed:
            if self._samples and stamp <= self._samples[-1].stamp:
                if stamp == self._samples[-1].stamp:
                    return
                self._samples.clear()  # another time base
            self._frame = msg.header.frame_id.lstrip('/')
            self._samples.append(_Sample(stamp, rate, np.array([a.x, a.y, a.z])))
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

    def up(self, stamp: int) -> F64 | None:
        """Direction (3,) away from gravity, sensor frame, in the second before a stamp (ns).

        None when it is not known, or the sensor moved. A steady acceleration cannot be told from
        a slope.
        """
        with self._changed:
            self._wait_for(stamp, _WAIT_S)
            kept = [s for s in self._samples if stamp - _REST_NS <= s.stamp <= stamp]
            T = self._extrinsic(self._frame)
        if T is None or len(kept) < 2 or kept[-1].stamp - kept[0].stamp < 0.5 * _REST_NS:
            self.level = 'not levelled: no accelerations on imu before the first cloud'
            return None
        forces = np.array([s.force for s in kept])
        mean = forces.mean(axis=0)
        size = float(np.linalg.norm(mean))
        scatter = float(np.sqrt(((forces - mean) ** 2).sum(axis=1).mean()))
        turning = float(np.linalg.norm(np.mean([s.rate for s in kept], axis=0)))
        known = any(abs(size - g) <= _EVEN * g for g in _GRAVITY)
        if not known or scatter > _EVEN * size or turning > _SLOWEST:
            self.level = 'not levelled: not at rest at the first cloud'
            return None
        self.level = 'levelled'
        up: F64 = T[:3, :3] @ mean / size
        return up

    def _wait_for(self, stamp: int, wait_s: float) -> None:
        """Wait until a sample of a stamp (ns) or later is there; the lock is held."""
        self._changed.wait_for(lambda: self._samples and self._samples[-1].stamp >= stamp, wait_s)

    def _between(
        self, since: int, until: int, wait_s: float
    ) -> tuple[NDArray[np.int64], F64] | None:
        """Instants (N,), the two given at the ends, and rates (N, 3) there, sensor frame."""
        with self._changed:
            self._wait_for(until, wait_s)
            kept, frame = list(self._samples), self._frame
        T = self._extrinsic(frame)
        if T is None:
            self.state = f'no transform from {self.sensor_frame} to {frame} on /tf_static'
            return None
        stamps = np.array([s.stamp for s in kept if since < s.stamp < until], np.int64)
        stamps = np.concatenate([[since], stamps, [until]])
        outside = not kept or kept[0].stamp > since + _GAP_NS or kept[-1].stamp < until - _GAP_NS
        if outside or until <= since or np.diff(stamps).max() > _GAP_NS:
            self.state = 'no angular rates on imu at the time'
            return None
        known = np.array([s.stamp for s in kept], np.int64)
        rates = np.array([s.rate for s in kept]) @ T[:3, :3].T
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
