# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sightings: what the last scan and the keyframe saw, as evidence for or against a pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.odometry.confidence import Evidence
from hybridreg_ros.odometry.rangeimage import ON, UNSEEN, RangeImage, View, view_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.cloud import Cloud
    from hybridreg_ros.odometry.preprocess import SensorModel

_ENOUGH_SEEN = 0.4
_SLACK, _SLACK_SHARE = 0.25, 0.0075
"""How far a point may be off a seen surface and still be on it: voxels, and share of the range."""


class Sightings:
    """Range images of the last accepted scan and of the newest keyframe.

    Args:
        sensor: kind and voxel size.
    """

    def __init__(self, sensor: SensorModel) -> None:
        self._slack_m = _SLACK * sensor.voxel_size_m
        self._slack_share = _SLACK_SHARE
        self._kind = sensor.kind
        self._view: View | None = None
        self._last: RangeImage | None = None
        self._keyframe: RangeImage | None = None

    def draw(self, cloud: Cloud, pose: NDArray[np.float64]) -> RangeImage:
        """Range image of a cloud at a pose; the first cloud decides the view."""
        rows = np.flatnonzero(cloud.usable)
        if self._view is None:
            self._view = view_of(cloud.points[rows], self._kind)
        return RangeImage(cloud.points, self._view, pose, rows)

    def keep(self, image: RangeImage, is_keyframe: bool) -> None:
        """Compare later scans with this one."""
        self._last = image
        if is_keyframe:
            self._keyframe = image

    def evidence(
        self, points: NDArray[np.float32], pose: NDArray[np.float64], overlap: float
    ) -> Evidence:
        """What speaks for a pose of points (K, 3), sensor frame.

        The last scan is asked first; the keyframe too where that one saw little.
        """
        found = self._against(self._last, points, pose, overlap)
        if found.seen < _ENOUGH_SEEN and self._keyframe is not self._last:
            other = self._against(self._keyframe, points, pose, overlap)
            if other.seen > found.seen:
                return other
        return found

    def _against(
        self,
        image: RangeImage | None,
        points: NDArray[np.float32],
        pose: NDArray[np.float64],
        overlap: float,
    ) -> Evidence:
        if image is None or len(points) == 0:
            return Evidence(overlap, 0.0, 0.0)
        stand = image.stand(points, pose, self._slack_m, self._slack_share)
        seen = int((stand != UNSEEN).sum())
        on = int((stand == ON).sum())
        return Evidence(overlap, seen / len(points), on / max(1, seen))
