# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Constant-velocity motion model: the prediction that starts a registration, and the twist."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import NS_PER_S

F64 = NDArray[np.float64]


class Motion:
    """The pose chain: last pose, its time, and the velocity there.

    Attributes:
        pose: (4, 4) T_odom_sensor of the last scan.
        stamp: its time, ns.
        twist: (6,) linear (m/s) and angular (rad/s) velocity, sensor frame.
        last_step_s: seconds between the last two poses.
    """

    def __init__(self, pose: F64 | None = None, stamp: int = 0) -> None:
        self.pose = np.eye(4) if pose is None else pose
        self.stamp = stamp
        self.twist = np.zeros(6)
        self.last_step_s = 0.0

    def predict(self, stamp: int) -> F64:
        """Pose (4, 4) at a stamp (ns) if the velocity stays as it is."""
        result: F64 = self.pose @ se3.exp(self.twist * self.seconds_to(stamp))
        return result

    def seconds_to(self, stamp: int) -> float:
        """Seconds from the last pose to a stamp (ns); integer arithmetic, so nothing is lost."""
        return (stamp - self.stamp) / NS_PER_S

    def advance(self, pose: F64, stamp: int) -> None:
        """Take a registered pose: the velocity follows from it."""
        dt = self.seconds_to(stamp)
        if dt > 0.0:
            self.twist = se3.log(se3.inverse(self.pose) @ pose) / dt
            self.last_step_s = dt
        self.pose, self.stamp = pose, stamp

    def hold(self, pose: F64, stamp: int) -> None:
        """Take a pose that says nothing about the velocity, which is kept (coasting)."""
        self.pose, self.stamp = pose, stamp

    def stop(self, stamp: int) -> None:
        """Stand still at the last pose from now on (lost, or a new time base)."""
        self.twist = np.zeros(6)
        self.stamp = stamp
