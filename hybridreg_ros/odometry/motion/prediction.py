# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Constant-velocity motion model: the prediction that starts a registration, and the twist."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import NS_PER_S

if TYPE_CHECKING:
    from hybridreg_ros.odometry.motion.intra_scan_motion import IntraScanMotion

F64 = NDArray[np.float64]

_KEPT, _ENOUGH = 10, 3
"""Errors of predictions that are kept, and from how many on their spread is believed."""
_FIRST_SPREAD = np.array([0.5, np.deg2rad(10.0)])
"""Standard deviation of a prediction about which nothing is known yet, metres and rad per axis."""
_MEDIAN_NORM = 0.888
"""Median length of a normal vector in three dimensions over the root of three."""
_MEDIAN_ABS = 0.6745
"""Median size of a normal variable."""
_LEAST_SHARE = 0.3
"""The angular velocity varies about each axis at least by this share of its mean over all."""
_LONGEST_S = 2.0
"""For so long a velocity goes on as it was; after a longer pause a sensor is as likely to have
stopped or turned, and is looked for where it would be then."""
_LEAST_SPREAD = np.array([0.01, np.deg2rad(0.1)])


@dataclass(frozen=True, eq=False)
class Expected:
    """Where the motion so far says that a scan is.

    Attributes:
        pose: (4, 4) pose by constant velocity.
        shift_m: standard deviation of its position along each axis, metres.
        turn_rad: standard deviation of its turn about each axis, rad.
        seconds: time since the last pose.
        turn_rate: (3,) standard deviation about each axis, sensor frame, of how the angular
            velocity has changed from scan to scan of late, rad/s; 0 = not known.
        start: where the scan begins, as the end of the last one says; None = not known.
        known: whether there has been a motion; else the sensor is taken to stand.
    """

    pose: F64
    shift_m: float
    turn_rad: float
    seconds: float
    turn_rate: F64 = field(default_factory=lambda: np.zeros(3))
    start: Start | None = None
    known: bool = True

    @property
    def is_proven(self) -> bool:
        """Whether its spread is that of predictions so far; else nothing is known of it."""
        return bool(self.turn_rate.any())

    def off(self, pose: F64) -> F64:
        """How far a pose (4, 4) is from it: (6,) shift and turn in standard deviations."""
        delta = se3.inverse(self.pose) @ pose
        turn = se3.so3_log(delta[:3, :3]) / self.turn_rad
        return np.concatenate([delta[:3, 3] / self.shift_m, turn])

    @property
    def information(self) -> F64:
        """(6,) diagonal of the information (position, turn about the sensor), alike along axes."""
        return np.repeat([self.shift_m**-2, self.turn_rad**-2], 3)

    def pull(self, pose: F64) -> tuple[F64, F64]:
        """What it adds to the Gauss-Newton system of a pose (4, 4), odom axes.

        Returns:
            (6,) diagonal of the information, and (6,) gradient.
        """
        weight = self.information
        turn = se3.so3_log(pose[:3, :3] @ self.pose[:3, :3].T)
        return weight, weight * np.concatenate([pose[:3, 3] - self.pose[:3, 3], turn])

    def fused(self, pose: F64, shift_m: float, turn_rad: float) -> Expected:
        """Best estimate of it and of a pose that is independent of it.

        Args:
            pose: (4, 4) the other pose.
            shift_m: standard deviation of its position along each axis, metres.
            turn_rad: standard deviation of its turn about each axis, rad.
        """
        delta = se3.inverse(pose) @ self.pose
        shift, turn = (
            b**2 / (a**2 + b**2) for a, b in ((self.shift_m, shift_m), (self.turn_rad, turn_rad))
        )
        between = np.eye(4)
        between[:3, :3] = se3.so3_exp(turn * se3.so3_log(delta[:3, :3]))
        between[:3, 3] = shift * delta[:3, 3]
        return replace(
            self,
            pose=pose @ between,
            shift_m=self.shift_m * shift**0.5,
            turn_rad=self.turn_rad * turn**0.5,
        )

    def widened(self, shift: float, turn: float) -> Expected:
        """The same pose with its spread times two factors."""
        start = self.start
        if start is not None:
            start = replace(start, shift_m=shift * start.shift_m, turn_rad=turn * start.turn_rad)
        shift_m, turn_rad = shift * self.shift_m, turn * self.turn_rad
        return replace(self, shift_m=shift_m, turn_rad=turn_rad, start=start)


class Motion:
    """The pose chain: last pose, its time, and the velocity there.

    The velocity follows from poses that were registered; poses that were only predicted, or that
    are in doubt, are passed over.

    Attributes:
        pose: (4, 4) T_odom_sensor of the last scan.
        stamp: its time, ns.
        twist: (6,) linear (m/s) and angular (rad/s) velocity, sensor frame.
        last_step_s: seconds between the poses that gave the velocity, 0 = it is not known.
        up: (3,) normal, odom axes, of the plane that the motion stays in; None = it is free.
    """

    def __init__(self, pose: F64 | None = None, stamp: int = 0) -> None:
        self.pose = np.eye(4) if pose is None else pose
        self.stamp = stamp
        self.twist = np.zeros(6)
        self.last_step_s = 0.0
        self.up: F64 | None = None
        self._sure = self.pose, stamp
        self._errors: deque[F64] = deque(maxlen=_KEPT)
        self._usual: tuple[F64, F64] | None = None

    def predict(self, stamp: int) -> F64:
        """Pose (4, 4) at a stamp (ns) if the velocity stays as it is, for a while."""
        result: F64 = self.pose @ se3.exp(self.twist * min(self.seconds_to(stamp), _LONGEST_S))
        return result

    def expect(self, stamp: int) -> Expected:
        """Pose at a stamp (ns), with the spread that predictions have had of late.

        An unknown acceleration moves the pose by the square of the time since the last sure one.
        """
        spread, turn_rate = _FIRST_SPREAD, np.zeros(3)
        if self._usual is not None and self.last_step_s > 0.0:
            spread, turn_rate = self._usual[0], self._usual[1] / self.last_step_s
            steps = (stamp - self._sure[1]) / (NS_PER_S * self.last_step_s)
            spread = spread * max(1.0, 0.5 * steps * (steps + 1.0))
        shift_m, turn_rad = float(spread[0]), float(spread[1])
        return Expected(
            self.predict(stamp),
            shift_m,
            turn_rad,
            self.seconds_to(stamp),
            turn_rate,
            known=self.last_step_s > 0.0,
        )

    def seconds_to(self, stamp: int) -> float:
        """Seconds from the last pose to a stamp (ns); integer arithmetic, so nothing is lost."""
        return (stamp - self.stamp) / NS_PER_S

    def advance(self, pose: F64, stamp: int) -> None:
        """Take a registered pose: the velocity follows from it and the last one of this kind."""
        since, before = self._sure
        dt = (stamp - before) / NS_PER_S
        if dt > 0.0:
            if self.last_step_s > 0.0 and before == self.stamp:
                off = se3.inverse(self.predict(stamp)) @ pose
                self._err(np.array([off[:3, 3], se3.so3_log(off[:3, :3])]))
            self.twist = se3.log(se3.inverse(since) @ pose) / dt
            self.last_step_s = dt
        self.pose, self.stamp = pose, stamp
        self._sure = pose, stamp

    def _err(self, error: F64) -> None:
        """Take the error (2, 3), shift and turn, of one more prediction."""
        self._errors.append(error)
        if len(self._errors) < _ENOUGH:
            return
        errors = np.array(self._errors)
        sizes = np.sqrt((errors**2).sum(axis=2) / 3.0)
        spread = np.maximum(np.sqrt((sizes**2).mean(axis=0)), _LEAST_SPREAD)
        usual = float(np.median(sizes[:, 1])) / _MEDIAN_NORM
        about = np.median(np.abs(errors[:, 1]), axis=0) / _MEDIAN_ABS
        self._usual = spread, np.maximum(about, _LEAST_SHARE * usual)

    def hold(self, pose: F64, stamp: int) -> None:
        """Take a pose that says nothing about the velocity, which is kept (coasting, doubt)."""
        self.pose, self.stamp = pose, stamp

    def stop(self, stamp: int, pose: F64 | None = None) -> None:
        """Stand still from now on, at a pose or at the last one (lost, or a new time base)."""
        self.twist = np.zeros(6)
        self.last_step_s = 0.0
        self.pose = self.pose if pose is None else pose
        self.stamp = stamp
        self._sure = self.pose, stamp


@dataclass(frozen=True, eq=False)
class Start:
    """Where a scan begins, as far as the end of the last one says.

    Attributes:
        second: of its first point, after the instant of its cloud.
        pose: (4, 4) there with the motion that its deskew undid left out, so that it compares with
            the pose of the cloud and its intra-scan motion.
        shift_m: standard deviation of its position along each axis, metres.
        turn_rad: standard deviation of its turn about each axis, rad.
    """

    second: float
    pose: F64
    shift_m: float
    turn_rad: float

    def pull(self, T_odom_sensor: F64, intra_scan: IntraScanMotion) -> tuple[F64, F64]:
        """What it adds to the Gauss-Newton system of pose and intra-scan motion, sensor frame.

        Returns:
            (18, 18) information of pose, rate and bend, and (18,) gradient.
        """
        off = se3.log(se3.inverse(self.pose) @ T_odom_sensor @ intra_scan.at(self.second))
        weight = np.repeat([self.shift_m**-2, self.turn_rad**-2], 3)
        powers = self.second ** np.arange(3)
        information = np.einsum('a,b,ij->aibj', powers, powers, np.diag(weight)).reshape(18, 18)
        return information, np.outer(powers, weight * off).ravel()
