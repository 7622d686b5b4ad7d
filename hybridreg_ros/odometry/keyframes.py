# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Keyframes: when to take one, which to match, and which to try when lost."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.pages import paged
from hybridreg_ros.core.scan import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import KeyframeConfig

_SAME_PLACE = 0.5
"""Keyframes nearer than half the way after which one is due show one place; so a sensor that stays
in a room keeps as many places, not as many looks at the same ones."""


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A scan that later ones are matched against.

    Attributes:
        number: running number, 0 for the first.
        stamp: ns.
        T_odom_keyframe: (4, 4) float64.
        points: (M, 3) float32, thinned, sensor frame, metres.
    """

    number: int
    stamp: int
    T_odom_keyframe: NDArray[np.float64]
    points: NDArray[np.float32]


class Keyframes:
    """A bounded list of keyframes, newest last.

    Args:
        config: settings.
        voxel_size_m: unit of the distance rule.
    """

    def __init__(self, config: KeyframeConfig, voxel_size_m: float) -> None:
        self._config = config
        self._reach_m = config.max_distance * voxel_size_m
        self._frames: deque[Keyframe] = deque(maxlen=config.memory)
        self._next = 0

    def __len__(self) -> int:
        """Keyframes kept."""
        return len(self._frames)

    def __iter__(self) -> Iterator[Keyframe]:
        """Oldest first."""
        return iter(self._frames)

    @property
    def last(self) -> Keyframe | None:
        """The newest keyframe."""
        return self._frames[-1] if self._frames else None

    @property
    def recent(self) -> list[Keyframe]:
        """The newest few: those that a scan may be matched against while it is not lost."""
        return list(self._frames)[-self._config.window :]

    def wanted(self, pose: NDArray[np.float64], stamp: int, overlap: float) -> bool:
        """Whether a scan at this pose should become a keyframe.

        Args:
            pose: (4, 4) T_odom_sensor.
            stamp: ns.
            overlap: share of the scan that the last keyframe sees too, [0, 1].
        """
        last = self.last
        if last is None:
            return True
        delta = se3.inverse(last.T_odom_keyframe) @ pose
        return (
            overlap < self._config.min_overlap
            or float(np.linalg.norm(delta[:3, 3])) > self._reach_m
            or se3.rotation_angle_deg(delta[:3, :3]) > self._config.max_angle_deg
            or abs(stamp - last.stamp) > self._config.max_age_s * NS_PER_S
        )

    def add(
        self,
        pose: NDArray[np.float64],
        stamp: int,
        points: NDArray[np.float32],
    ) -> Keyframe:
        """Keep a scan; older ones of the same place go, and the oldest when the memory is full."""
        frame = Keyframe(self._next, stamp, pose, paged(points))
        recent = self.recent
        newer = [*(f.T_odom_keyframe for f in recent), pose]
        self._frames = deque(
            (
                f
                for f in self._frames
                if f in recent or min(self.distance(f, place) for place in newer) >= _SAME_PLACE
            ),
            maxlen=self._config.memory,
        )
        self._frames.append(frame)
        self._next += 1
        return frame

    def mend(self, pose: NDArray[np.float64], points: NDArray[np.float32]) -> Keyframe:
        """Put the newest keyframe elsewhere, with other points; its number stays."""
        frame = replace(self._frames.pop(), T_odom_keyframe=pose, points=paged(points))
        self._frames.append(frame)
        return frame

    def to_match(self, predicted: NDArray[np.float64]) -> Keyframe | None:
        """Of the newest few, the one nearest to where the sensor should be (turns count too)."""
        return min(self.recent, key=lambda f: self.distance(f, predicted), default=None)

    def nearest(self, pose: NDArray[np.float64], count: int) -> list[Keyframe]:
        """The keyframes nearest to a pose, for relocalisation."""
        return sorted(self._frames, key=lambda f: self.distance(f, pose))[:count]

    def clear(self) -> None:
        """Forget all; numbers go on."""
        self._frames.clear()

    def distance(self, frame: Keyframe, pose: NDArray[np.float64]) -> float:
        """How far a pose is from a keyframe, in units of the keyframe rule."""
        delta = se3.inverse(frame.T_odom_keyframe) @ pose
        shift = float(np.linalg.norm(delta[:3, 3])) / self._reach_m
        return shift + se3.rotation_angle_deg(delta[:3, :3]) / self._config.max_angle_deg
