# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""UsualMotion: what is known of the motion within a scan when nothing says where it begins."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.motion.intra_scan_motion import IntraScanMotion

    F64 = NDArray[np.float64]

_TURN = float(np.deg2rad(3.0))
"""Standard deviation of the angular velocity within a scan about the predicted one, rad/s, before
any scan has shown it: as much is known of it as one scan shows."""
_KEPT = 0.9
"""Weight of what was known, with each scan: it is that of ten scans at most."""
_TAKEN_UP = 0.25
"""Share by which a scan that is straightened straightens the map that the next one sees: 0.2 to
0.3 on development streets (docs/lab/2026-11-30-pose-at-the-stamp.md)."""


@dataclass(frozen=True, eq=False)
class UsualMotion:
    """How a sensor turns within scans, and how the map only makes it seem to.

    A map made of scans that were bent alike shows a turn in every scan, though the sensor did not
    turn; no registration can tell. But on the average over some scans, rate and bend within them
    are those of the ways between them, however rough the ride is. What is left of the average is
    the map's: it is taken out of the next scan, and the map unbends.

    Attributes:
        shared: (2, 6) rate and bend that the map shows in every scan, as in `IntraScanMotion`;
            linear parts zero, since much less is known of them.
        squares: (2, 3) sums of the squares of the turns of rate and bend found beyond them, with
            their variances: rad^2/s^2 and rad^2/s^4.
        scans: number of scans in those sums.
    """

    shared: F64 = field(default_factory=lambda: np.zeros((2, 6)))
    squares: F64 = field(default_factory=lambda: np.zeros((2, 3)))
    scans: float = 0.0

    def variance(self, half_span_s: float, turns: F64) -> F64:
        """(2, 3) variance of the turns of rate and bend about each axis, beside the shared ones.

        The motion in doubt is one of those that show it (the precision that a Student t prior has
        there): the first jolt of a ride is as large as it is.

        Args:
            half_span_s: half the duration of the scan, seconds.
            turns: (2, 3) those of the present scan, as far as they are known.
        """
        first = (_TURN / np.array([[1.0], [half_span_s]])) ** 2
        variance: F64 = (self.squares + turns**2 + first) / (self.scans + 2.0)
        return variance

    def own(self, found: IntraScanMotion) -> IntraScanMotion:
        """A motion found in the map without what the map shows in every scan."""
        rate, bend = self.shared
        return replace(found, rate=found.rate - rate, bend=found.bend - bend)

    def after(self, own: IntraScanMotion, left: F64) -> UsualMotion:
        """What is known after one more scan.

        A first map is bent by half of what the rate changed between its two scans, so what is left
        has half of the variance of a scan before any has shown more.

        Args:
            own: motion within the scan.
            left: (2, 6) rate and bend, over it and the scan before, beyond those of the way
                between the two.
        """
        turns = np.array([own.rate[3:], own.bend[3:]])
        shared = (1.0 - _TAKEN_UP) * self.shared
        shared[:, 3:] += left[:, 3:] / (self.scans + 3.0)
        variance = np.diag(own.covariance).reshape(2, 6)[:, 3:]
        squares = _KEPT * self.squares + turns**2 + variance
        return UsualMotion(shared, squares, _KEPT * self.scans + 1.0)
