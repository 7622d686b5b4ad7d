# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Intake: which scans are taken at all, by stamp and frame; refusals are counted."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.result import Reason

if TYPE_CHECKING:
    from hybridreg_ros.core.scan import Scan
    from hybridreg_ros.odometry.config import InputConfig


class Intake:
    """Checks stamps and frame of every scan against the last one taken.

    One odd stamp is refused. When `rebase_after` scans in a row agree on another time base (a
    bag that starts again, a clock that was set), it becomes the new one. A scan of another frame
    is refused until `reset`: its pose relative to the old frame is not known.

    Attributes:
        refused: how many scans were refused for each reason.
    """

    def __init__(self, config: InputConfig) -> None:
        self._config = config
        self.refused: Counter[Reason] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget stamp and frame; the next scan is taken whatever it says. Counters stay."""
        self._stamp: int | None = None
        self._frame_id = ''
        self._odd_stamp: int | None = None
        self._odd_count = 0

    def check(self, scan: Scan) -> Reason | None:
        """Why a scan is refused, or None when it is taken."""
        fault = self._fault(scan)
        if fault is None:
            self._stamp, self._frame_id = scan.stamp, scan.frame_id
            self._odd_stamp, self._odd_count = None, 0
        else:
            self.refused[fault] += 1
        return fault

    def rebased(self, scan: Scan) -> bool:
        """Whether this scan, refused for its stamp, proves that the time base has changed."""
        if scan.frame_id != self._frame_id:
            return False
        step = None if self._odd_stamp is None else scan.stamp - self._odd_stamp
        steady = step is not None and 0 < step <= self._config.max_gap_s * NS_PER_S
        self._odd_count = self._odd_count + 1 if steady else 1
        self._odd_stamp = scan.stamp
        if self._odd_count < self._config.rebase_after:
            return False
        self._stamp = scan.stamp
        self._odd_stamp, self._odd_count = None, 0
        return True

    def _fault(self, scan: Scan) -> Reason | None:
        if self._stamp is None:
            return None
        if scan.frame_id != self._frame_id:
            return Reason.FRAME_CHANGED
        step = scan.stamp - self._stamp
        if step == 0:
            return Reason.STAMP_REPEATED
        if step < 0:
            return Reason.STAMP_BACKWARDS
        if step > self._config.max_gap_s * NS_PER_S:
            return Reason.STAMP_JUMP
        return None
