# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""ScanContinuity: what earlier scans say of the motion within one of a spinning lidar."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.motion.prediction import Start
from hybridreg_ros.odometry.motion.usual_motion import UsualMotion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.motion.intra_scan_motion import IntraScanMotion
    from hybridreg_ros.odometry.motion.prediction import Expected
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan

    F64 = NDArray[np.float64]

_SPREAD = np.array([0.01, np.deg2rad(0.2)])
"""Standard deviation of the end of a scan, metres and rad per axis."""
_AT_FIRST, _EASED = 16.0, 0.7
"""Factor on that before the first end of a scan, and its decay with each: the map of the first
scans is bent by what was not known of their motion, and a pose must not jump by it."""
_GAP_S = 0.05
"""After a longer pause the end of the last scan says no more than the prediction does."""
_STEP_S = 0.01


class ScanContinuity:
    """Where the last scan ended, and how the sensor has turned within scans of late.

    There are two states of knowledge. A scan that follows on the last one begins where that ended.
    Where scans are left out, or after a pause, that says nothing, and the motion within the scan
    is as it has been within other such scans.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Nothing is known of how the last scan ended."""
        self._factor, self._usual = _AT_FIRST, UsualMotion()
        self.end()

    def end(self) -> None:
        """The last scan is in doubt or was not registered, so it is not continued."""
        self._end: tuple[F64, F64, int] | None = None
        self._last: tuple[int, F64, F64] | None = None

    def informed(self, cloud: PreprocessedScan, seconds: float) -> PreprocessedScan:
        """A cloud with what earlier scans say of the motion within it, where scans are left out.

        Args:
            cloud: the preprocessed scan.
            seconds: time since the last scan.
        """
        if cloud.times is None or seconds - float(np.ptp(cloud.times)) <= _GAP_S:
            return cloud
        return replace(cloud, usual=self._usual)

    def expect(self, expected: Expected, cloud: PreprocessedScan, stamp: int) -> Expected:
        """What is expected of a scan, with its start when the last one ended shortly before.

        Without that, a motion that is the same in every scan (a nod at the same azimuth, back at
        once when the next scan begins) bends scans and map alike and is seen by no registration.

        Args:
            expected: pose of the cloud by constant velocity.
            cloud: the preprocessed scan.
            stamp: instant of the cloud, ns.
        """
        if self._end is None or cloud.times is None:
            return expected
        end, twist, ended = self._end
        second = float(cloud.times.min())
        gap_s = (stamp - ended) / NS_PER_S + second
        if abs(gap_s) > _GAP_S:
            return expected
        pose = end @ se3.exp(twist * gap_s) @ se3.exp(-cloud.twist * second)
        grown = gap_s / max(expected.seconds, _STEP_S)
        shift_m, turn_rad = self._factor * _SPREAD
        start = Start(
            second,
            pose,
            float(shift_m + grown**2 * expected.shift_m),
            float(turn_rad + grown**2 * expected.turn_rad),
        )
        return replace(expected, start=start)

    def end_at(
        self,
        cloud: PreprocessedScan,
        T_odom_sensor: F64,
        intra_scan: IntraScanMotion | None,
        stamp: int,
    ) -> None:
        """Take the end of a scan that was registered.

        Args:
            cloud: the preprocessed scan.
            T_odom_sensor: (4, 4) its pose.
            intra_scan: motion during it that its deskew did not undo, or None.
            stamp: instant of the cloud, ns.
        """
        if cloud.times is None:
            return
        if intra_scan is not None:
            moves = np.array([cloud.rate(intra_scan), intra_scan.bend])
            if cloud.usual is not None:
                left = np.zeros((2, 6))
                if self._last is not None:
                    since, before, moved = self._last
                    way = se3.log(se3.inverse(before) @ T_odom_sensor), 0.5 * (moves[0] - moved[0])
                    # Mean over both scans beyond what the way between them shows.
                    left = 0.5 * (moved + moves) - NS_PER_S * np.array(way) / (stamp - since)
                self._usual = cloud.usual.after(intra_scan, left)
            self._last = stamp, T_odom_sensor, moves
        last = float(cloud.times.max())
        self._factor = max(1.0, _EASED * self._factor)
        pose = cloud.pose_at(last, T_odom_sensor, intra_scan)
        earlier = cloud.pose_at(last - _STEP_S, T_odom_sensor, intra_scan)
        twist = se3.log(se3.inverse(earlier) @ pose) / _STEP_S
        self._end = pose, twist, stamp + round(last * NS_PER_S)
