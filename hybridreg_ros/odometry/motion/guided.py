# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""GuidedMotion: predictions by another sensor (wheels, say) where it has something to say."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.motion.prediction import Motion

if TYPE_CHECKING:
    from collections.abc import Callable

    from hybridreg_ros.odometry.motion.prediction import F64

    Guide = Callable[[int, int, F64], F64]


class GuidedMotion(Motion):
    """The pose chain with predictions that a guide corrects.

    The guess is where a registration starts and what it is judged against, nothing more: how far
    guesses were off of late is what the next one is trusted by, as with constant velocity.

    Args:
        guide: given two instants, ns, and the motion (4, 4) of the sensor between them by constant
            velocity, gives that motion as far as it knows better.
    """

    def __init__(self, guide: Guide) -> None:
        super().__init__()
        self._guide = guide
        self._asked: tuple[int, int] | None = None
        self._answer = self.pose

    def turn(self, rate: F64) -> None:
        """Take a measured rate (3,), sensor frame, rad/s, for the deskew of the next scan."""
        self.twist = np.concatenate([self.twist[:3], rate])

    def predict(self, stamp: int) -> F64:
        """Pose (4, 4) at a stamp (ns) as the guide says, which is asked once for each step."""
        steady = se3.inverse(self.pose) @ super().predict(stamp)
        if self._asked != (self.stamp, stamp):
            self._asked = self.stamp, stamp
            self._answer = self._guide(self.stamp, stamp, steady)
        result: F64 = self.pose @ self._answer
        return result
