# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A small deterministic registrar: small_gicp, started from where scan and keyframe are near."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import small_gicp

from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.odometry.network_branch import Match

if TYPE_CHECKING:
    from numpy.typing import NDArray


class NeighbourhoodRegistrar:
    """GICP from a few turned starts; the best inlier share wins and is the confidence.

    Attributes:
        dim: factor on the confidence, to make the gate close in a test.
        shift_m: error put on the result along x, to make it wrong in a test.
        doubt: uncertainty of every point.
        matches: how often `match` ran.
        encodes: how often `encode` ran.
    """

    def __init__(self, turns_deg: tuple[float, ...] = (0.0,)) -> None:
        self.dim = 1.0
        self.shift_m = 0.0
        self.doubt = 0.0
        self.matches = 0
        self.encodes = 0
        self._turns_deg = turns_deg

    def encode(self, points: NDArray[np.float32]) -> NDArray[np.float64]:
        self.encodes += 1
        if len(points) < 50:
            raise RegistrationError(f'expected at least 50 points, found {len(points)}')
        return points.astype(np.float64)

    def match(self, scan: NDArray[np.float64], keyframe: NDArray[np.float64]) -> Match:
        self.matches += 1
        results = [self._align(scan, keyframe, turn) for turn in self._turns_deg]
        best = max(results, key=lambda r: (r.num_inliers, -r.error))
        T = np.array(best.T_target_source)
        T[0, 3] += self.shift_m
        share = min(1.0, 1.2 * best.num_inliers / max(1, self._size))
        return Match(
            T, self.dim * share, np.full(len(scan), self.doubt, np.float32), best.num_inliers
        )

    def _align(
        self, scan: NDArray[np.float64], keyframe: NDArray[np.float64], turn_deg: float
    ) -> small_gicp.RegistrationResult:
        a = np.deg2rad(turn_deg)
        start = np.eye(4)
        start[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
        target, tree = small_gicp.preprocess_points(keyframe, 0.15)
        source, _ = small_gicp.preprocess_points(scan, 0.15)
        self._size = source.size()
        return small_gicp.align(
            target, source, tree, start, max_correspondence_distance=0.6, max_iterations=30
        )
