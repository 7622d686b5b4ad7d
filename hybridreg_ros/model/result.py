# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What registration keeps of a cloud, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.model.pose.confidence import ConfidenceFeatures


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Matched points.

    Attributes:
        source: (C, 3) float32, source frame, metres.
        target: (C, 3) float32, target frame, metres.
        weights: (C,) float32 in [0, 1].
    """

    source: NDArray[np.float32]
    target: NDArray[np.float32]
    weights: NDArray[np.float32]

    def __len__(self) -> int:
        """Number of correspondences C."""
        return len(self.weights)


@dataclass(frozen=True, eq=False)
class RegistrationResult:
    """Outcome of one registration.

    Attributes:
        T_target_source: (4, 4) float64, metres, refined.
        confidence: P(T_target_source right), [0, 1].
        source_uncertainty: (N,) float32 sigma2 in [0, 1] of every input point; 1 = do not trust
            (moving, deforming, not seen by the other cloud, or NaN in the input): the network's
            mask, corrected by where the point lies once the pose is known.
        target_uncertainty: (M,) float32.
        correspondences: point matches of the network.
        T_lgr: (4, 4) float64, metres, pose of the point matches alone, before verification and
            refinement.
        inliers: number of correspondences that agree with the pose before its refinement.
        voxel_size_m: finest voxel used.
        features: what the confidence was computed from.
        timings_s: seconds per stage: encode, network, verify, refine, total; of all attempts.
        attempts: number of registrations, each done another way, that this is the best of.
        source_static_probability: (N,) float32 P(static) of every input point under the pose; 0.5
            for NaN. None of a result of `match`, whose caller may know a better pose
            (`HybridReg.point_mask`), and of weights without a static head.
        target_static_probability: (M,) float32, likewise.
    """

    T_target_source: NDArray[np.float64]
    confidence: float
    source_uncertainty: NDArray[np.float32]
    target_uncertainty: NDArray[np.float32]
    correspondences: Correspondences
    T_lgr: NDArray[np.float64]
    inliers: int
    voxel_size_m: float
    features: ConfidenceFeatures
    timings_s: Mapping[str, float] = field(default_factory=dict)
    attempts: int = 1
    source_static_probability: NDArray[np.float32] | None = None
    target_static_probability: NDArray[np.float32] | None = None

    @property
    def T_keyframe_scan(self) -> NDArray[np.float64]:
        """`T_target_source` by the name that odometry gives it (source = scan)."""
        return self.T_target_source

    @property
    def uncertainty(self) -> NDArray[np.float32]:
        """`source_uncertainty` by the name that odometry gives it."""
        return self.source_uncertainty
