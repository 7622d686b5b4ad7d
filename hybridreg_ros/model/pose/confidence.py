# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Confidence: the probability that a registration is right, by a logistic model of its traces."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.config import option, validate
from hybridreg_ros.core.errors import ConfigError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from hybridreg_ros.model.network.estimators import PoseEstimate
    from hybridreg_ros.model.network.matching import MatchOutput
    from hybridreg_ros.model.pose.refine import Refinement
    from hybridreg_ros.model.pose.verify import Verified


@dataclass(frozen=True)
class ConfidenceFeatures:
    """Traces that a right registration leaves and a wrong one does not.

    Attributes:
        log_inliers: log(1 + point matches within the acceptance radius).
        inlier_ratio: their share of all point matches.
        agreeing: share of the patch hypotheses that agree with the final pose.
        overlap: share of the source points with a target point within one voxel.
        residual: root mean square distance of those, voxels.
        trust: mean of 1 - sigma2 over the superpoints of both clouds.
        constraint: smallest over largest eigenvalue of the translational information, 0 = the
            surfaces let the clouds slide (one plane, a corridor).
        correction: distance that the refinement moved the cloud's centre, voxels.
        support: number of source points tried with a target point within one voxel; not part
            of the logistic model, see `PairCalibration.probability`.
        fit: share of both clouds that lies on the other, nearer counts more.
        intrusion: share of both clouds in space that the other's sensor looked through.
        lead: of the pose over the best one that differs, 1 less the ratio of their odds.
        agreement: share of the descriptor matches that agree.
        matched: log(1 + descriptor matches that agree).
        trusted: the fit with every point weighted by the network's trust in it.
        resemblance: mean similarity of the fine features that meet.
    """

    log_inliers: float = 0.0
    inlier_ratio: float = 0.0
    agreeing: float = 0.0
    overlap: float = 0.0
    residual: float = 1.0
    trust: float = 0.0
    constraint: float = 0.0
    correction: float = 0.0
    support: int = 0
    fit: float = 0.0
    intrusion: float = 0.0
    lead: float = 0.0
    agreement: float = 0.0
    matched: float = 0.0
    trusted: float = 0.0
    resemblance: float = 0.0

    def vector(self) -> NDArray[np.float64]:
        """The features as (15,) float64, in the order of `feature_names`."""
        return np.array([getattr(self, name) for name in feature_names()])


def feature_names() -> tuple[str, ...]:
    """Names of the features, in the order of the calibration's weights."""
    return tuple(f.name for f in fields(ConfidenceFeatures) if f.name != 'support')


def features_of(
    found: MatchOutput,
    estimate: PoseEstimate,
    refined: Refinement,
    verified: Verified | None,
    trusted: tuple[float, float],
) -> ConfidenceFeatures:
    """What the confidence looks at; without verification its features stay 0.

    `trusted`: fit of the trusted points and resemblance, from `evidence.trusted_fit`.
    """
    inliers, matches = int(estimate.inliers.sum()), len(found.weights)
    sigma2 = np.concatenate([found.source_sigma2, found.target_sigma2])
    features = ConfidenceFeatures(
        log_inliers=float(np.log1p(inliers)),
        inlier_ratio=inliers / max(matches, 1),
        agreeing=estimate.agreeing,
        overlap=refined.overlap,
        residual=refined.residual,
        trust=float(1.0 - sigma2.mean()),
        constraint=refined.constraint,
        correction=refined.correction,
        support=refined.support,
        trusted=trusted[0],
        resemblance=trusted[1],
    )
    if verified is None:
        return features
    return dataclasses.replace(
        features,
        fit=verified.fit,
        intrusion=verified.intrusion,
        lead=verified.lead,
        agreement=verified.agreement,
        matched=float(np.log1p(verified.matched)),
    )


# Uncalibrated: chosen by hand so that an untrained network, a bare plane, or fewer than about 30
# inliers stay below one half. Training fits these and stores them with the weights.
_DEFAULT_WEIGHTS = (1.2, 2.0, 1.5, 3.0, -2.0, 0.0, 4.0, -0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_DEFAULT_BIAS = -7.5
_FULL_CONSTRAINT = 0.01
_FULL_SUPPORT = 150


@dataclass(frozen=True)
class PairCalibration:
    """Logistic model of the confidence, stored with the weights."""

    weights: tuple[float, ...] = option(_DEFAULT_WEIGHTS, 'one per confidence feature')
    bias: float = option(_DEFAULT_BIAS, 'log-odds at zero features')
    fitted: bool = option(False, 'False: hand-set, conservative, not calibrated')

    def __post_init__(self) -> None:
        """Check the number of weights.

        Raises:
            ConfigError: another number of weights than of features.
        """
        validate(self)
        if len(self.weights) != len(feature_names()):
            raise ConfigError(
                f'weights: expected {len(feature_names())} numbers, found {len(self.weights)}'
            )

    def probability(self, features: ConfidenceFeatures) -> float:
        """P(registration right), [0, 1]; 0 when the features are not finite.

        Whatever the logistic model says, the probability fades out where the clouds can slide on
        each other (one plane, a bare corridor) and where too few points meet.
        """
        logistic = self.logistic(features.vector())
        fixed = min(features.constraint / _FULL_CONSTRAINT, 1.0)
        met = min(features.support / _FULL_SUPPORT, 1.0)
        return logistic * fixed * met

    def logistic(self, vector: ArrayLike) -> float:
        """The logistic model alone (features as in `feature_names`); 0 when not finite."""
        odds = float(np.dot(self.weights, np.asarray(vector)) + self.bias)
        return float(0.5 * (1.0 + np.tanh(0.5 * odds))) if np.isfinite(odds) else 0.0
