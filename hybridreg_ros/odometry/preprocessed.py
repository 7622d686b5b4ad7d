# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""PreprocessedScan: a preprocessed scan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.map.thinning import means_of
from hybridreg_ros.odometry.motion.intra_scan_motion import IntraScanMotion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.motion.usual_motion import UsualMotion


@dataclass(frozen=True, eq=False)
class PreprocessedScan:
    """A preprocessed scan.

    Attributes:
        points: (N, 3) float32, all points of the scan, deskewed, sensor frame, metres.
        usable: (N,) bool, inside the range limits.
        map_rows: (M,) rows of `points` thinned for the map.
        icp_rows: (K,) rows of `points` thinned for registration.
        means: (M, 3) float32, mean of the points in the cube of each map row: less noise than one.
        counts: (M,) int32 points in that cube.
        cube: (N,) int32 cube of each point, -1 outside the range limits.
        deskewed: True when the motion during the scan was undone.
        instant_s: instant of `points`, seconds after the scan's stamp.
        reported_s: instant at which the pose is wanted, seconds after the scan's stamp.
        twist: (6,) velocity by which it was deskewed, sensor frame.
        times: (N,) seconds of each point after `instant_s`; None = only an even motion is undone.
        icp_share: share of the registered points that counts as independent, (0, 1].
        usual: what earlier scans say of the motion within it, where nothing says how it begins
            since scans were left out; else None.
    """

    points: NDArray[np.float32]
    usable: NDArray[np.bool_]
    map_rows: NDArray[np.int64]
    icp_rows: NDArray[np.int64]
    means: NDArray[np.float32]
    counts: NDArray[np.int32]
    cube: NDArray[np.int32]
    deskewed: bool
    instant_s: float
    reported_s: float
    twist: NDArray[np.float64]
    times: NDArray[np.float64] | None
    icp_share: float = 1.0
    usual: UsualMotion | None = None

    @cached_property
    def map_points(self) -> NDArray[np.float32]:
        """(M, 3) measured points, thinned; the network gets them."""
        return self.points[self.map_rows]

    @cached_property
    def icp_in_map(self) -> NDArray[np.int64]:
        """(K,) place of each registered point among the map points."""
        return np.searchsorted(self.map_rows, self.icp_rows)

    @cached_property
    def icp_points(self) -> NDArray[np.float32]:
        """(K, 3) points that are registered: means of the cubes of `icp_rows`."""
        return self.means[self.icp_in_map]

    @cached_property
    def reach_m(self) -> float:
        """Median range of the registered points, metres."""
        return float(np.median(np.linalg.norm(self.icp_points, axis=1)))

    @cached_property
    def icp_times(self) -> NDArray[np.float64] | None:
        """(K,) seconds of each registered point after the instant, None when there are none."""
        return None if self.times is None else self.times[self.icp_rows]

    def straightened(self, intra_scan: IntraScanMotion) -> PreprocessedScan:
        """The same cloud with the motion during the scan undone that its deskew left."""
        assert self.times is not None
        points = intra_scan.undo(self.points, self.times)
        means, _ = means_of(points, self.cube, len(self.map_rows))
        return replace(self, points=points, means=means)

    def icp_with(self, intra_scan: IntraScanMotion | None) -> NDArray[np.float32]:
        """(K, 3) points that are registered, with an intra-scan motion undone."""
        points, times = self.icp_points, self.icp_times
        return points if intra_scan is None or times is None else intra_scan.undo(points, times)

    def reported(
        self, pose: NDArray[np.float64], intra_scan: IntraScanMotion | None = None
    ) -> NDArray[np.float64]:
        """Pose (4, 4) at the instant that is asked for, from that of the points."""
        return self.pose_at(self.reported_s - self.instant_s, pose, intra_scan)

    def pose_at(
        self, second: float, pose: NDArray[np.float64], intra_scan: IntraScanMotion | None = None
    ) -> NDArray[np.float64]:
        """Pose (4, 4) so many seconds after the instant of the points, from that of the points."""
        even: NDArray[np.float64] = pose if intra_scan is None else pose @ intra_scan.at(second)
        return even @ se3.exp(self.twist * second)

    def rate(self, intra_scan: IntraScanMotion | None) -> NDArray[np.float64]:
        """Velocity (6,) at the instant of the points, with an intra-scan motion."""
        return self.twist if intra_scan is None else self.twist + intra_scan.rate

    def moved_by(self, twist: NDArray[np.float64]) -> PreprocessedScan:
        """A cloud that was taken to stand still, deskewed by a velocity (6,) known since."""
        moved = self.straightened(IntraScanMotion(twist - self.twist, np.zeros(6)))
        return replace(moved, twist=twist)
