# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sightings: what earlier scans saw of what stands still, as evidence about a pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.selection.pose_confidence import PoseEvidence
from hybridreg_ros.odometry.visibility.range_image import (
    BEHIND,
    FRONT,
    ON,
    UNSEEN,
    Pixels,
    RangeImage,
    view_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.keyframes import Keyframe
    from hybridreg_ros.odometry.preprocess import SensorModel
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan

_OTHERS = 3
_TURN_M = 3.0
"""Metres of way that count as much as a radian of turn, when the nearest images are chosen."""
_SLACK, _SLACK_SHARE = 0.25, 0.0075
"""How far a point may be off a seen surface and still be on it: voxels, and share of the range."""


class Sightings:
    """Range images of the still points of the last accepted scan and of the keyframes.

    Movers are not drawn: what stood right before the camera says nothing about what is behind.

    Args:
        sensor: kind and voxel size.
    """

    def __init__(self, sensor: SensorModel) -> None:
        self._slack_m = _SLACK * sensor.voxel_size_m
        self._kind = sensor.kind
        self._view: Pixels | None = None
        self._last: RangeImage | None = None
        self._keyframes: dict[int, RangeImage] = {}

    def draw(self, cloud: PreprocessedScan, pose: NDArray[np.float64]) -> RangeImage:
        """Range image of a cloud at a pose (4, 4); the first cloud decides the view."""
        if self._view is None:
            self._view = view_of(cloud.points[cloud.usable], self._kind)
        return RangeImage(cloud.points, self._view, pose, cloud.usable)

    def keep(self, image: RangeImage, keyframes: Iterable[Keyframe] = ()) -> None:
        """Compare later scans with this one.

        Args:
            image: what the scan saw.
            keyframes: if it has become one, all that are kept, it at the end; images of others go.
        """
        numbers = [keyframe.number for keyframe in keyframes]
        self._last = image.paged() if numbers else image.kept()
        if numbers:
            known = {**self._keyframes, numbers[-1]: self._last}
            self._keyframes = {n: known[n] for n in numbers if n in known}

    def clear(self) -> None:
        """Forget all images; the view stays."""
        self._last = None
        self._keyframes.clear()

    def evidence(
        self, points: NDArray[np.float32], pose: NDArray[np.float64], overlap: float
    ) -> PoseEvidence:
        """What speaks for a pose of points (K, 3), sensor frame.

        The last scan is asked first; of points that it did not see or that something hid from it
        the keyframes nearest to the pose are asked.
        """
        if self._last is None or len(points) == 0:
            return PoseEvidence(overlap, 0.0, 0.0)
        stand = self._against(self._last, points, pose)
        for image in self._nearest(pose):
            open_ = np.flatnonzero((stand == UNSEEN) | (stand == BEHIND))
            if len(open_) == 0:
                break
            other = self._against(image, points[open_], pose)
            stand[open_] = np.where(other == UNSEEN, stand[open_], other)
        seen = int((stand != UNSEEN).sum())
        on, front = int((stand == ON).sum()), int((stand == FRONT).sum())
        share = 1.0 / max(1, seen)
        return PoseEvidence(overlap, seen / len(points), on * share, front * share)

    def _nearest(self, pose: NDArray[np.float64]) -> list[RangeImage]:
        """The keyframes nearest to a pose, without the last scan."""
        others = [image for image in self._keyframes.values() if image is not self._last]
        return sorted(others, key=lambda image: _apart_m(image.T_odom_sensor, pose))[:_OTHERS]

    def _against(
        self, image: RangeImage, points: NDArray[np.float32], pose: NDArray[np.float64]
    ) -> NDArray[np.int8]:
        return image.stand(points, pose, self._slack_m, _SLACK_SHARE)


def _apart_m(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """How far apart two poses are, turns included, metres."""
    delta = se3.inverse(one) @ other
    turn = np.deg2rad(se3.rotation_angle_deg(delta[:3, :3]))
    return float(np.linalg.norm(delta[:3, 3])) + _TURN_M * float(turn)
