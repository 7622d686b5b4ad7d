# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Load: how much of a step is done while clouds come faster than they can be taken."""

from __future__ import annotations

from dataclasses import dataclass

from hybridreg_ros.model.budget import Budget


@dataclass(frozen=True)
class Effort:
    """How much of a step is done.

    Attributes:
        level: 0 = all of it.
        update_every: mask, map and keyframes are made of every n-th scan, and where a keyframe is
            due; the mask of the others is what was known of their places.
        thorough: whether, while a pose is in doubt, the network looks again at the full budget and
            kiss-icp starts from other guesses; and whether the network says which points are
            static, beside the past.
        first_look: budget of points at which the network looks first.
        newest: whether of waiting clouds the newest is taken, else the one that waits longest.
    """

    level: int
    update_every: int
    thorough: bool
    first_look: Budget
    newest: bool


QUICK = Budget(5_000, 100)
"""Budget of the first look. Seven lidar sequences at stride 1: the poses of 256 superpoints at
half the cost (docs/lab/2026-11-29-step-time.md)."""
HASTY = Budget(2_500, 64)
"""Where the static head is not asked: the same poses, but too little for it
(docs/lab/2026-11-30-live-at-its-own-pace.md)."""
FULL = Budget()
"""Budget where the first look is not sure, and to find the pose again after a loss."""
EFFORTS = (
    Effort(0, 1, thorough=True, first_look=QUICK, newest=False),
    Effort(1, 1, thorough=False, first_look=HASTY, newest=False),
    Effort(2, 2, thorough=False, first_look=HASTY, newest=True),
    Effort(3, 3, thorough=False, first_look=HASTY, newest=True),
)
"""From all to least."""
_CALM_SCANS = 20, 320
"""So many scans in a row in time, and a level less is tried: at least, and at most where that has
failed again and again."""


class Load:
    """Less per scan at once when clouds have to wait, more again after a calm while.

    What the front end's own slowness drops makes the steps between scans larger and each of them
    harder; so it must not go on doing all of a step.
    """

    def __init__(self) -> None:
        self._level = 0
        self._calm = 0
        self._patience = _CALM_SCANS[0]

    @property
    def last(self) -> Effort:
        """Effort of the last scan."""
        return EFFORTS[self._level]

    def effort(self, behind: bool) -> Effort:
        """Effort for the next scan.

        Args:
            behind: whether later clouds wait already, or were dropped since the last scan.
        """
        low, high = _CALM_SCANS
        if behind:
            self._level, self._calm = min(self._level + 1, len(EFFORTS) - 1), 0
            self._patience = min(2 * self._patience, high)
            return EFFORTS[self._level]
        self._calm += 1
        if self._calm >= self._patience:
            self._calm = 0
            if self._level == 0:
                self._patience = max(self._patience // 2, low)
            self._level = max(self._level - 1, 0)
        return EFFORTS[self._level]
