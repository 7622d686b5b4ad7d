# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fit of the confidence that is reported, on runs of the development suite as in use."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hybridreg_ros.benchmark.suite_fit import follow, left_out
from hybridreg_ros.core.errors import HybridRegError
from hybridreg_ros.core.provenance import collect
from hybridreg_ros.metrics.calibration import expected_calibration_error, fit_logistic, sigmoid
from hybridreg_ros.odometry.config import GateConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.result import Reason
from hybridreg_ros.odometry.selection.calibration import (
    REPORTED,
    Logistic,
    OdometryCalibration,
    packaged,
)

if TYPE_CHECKING:
    from collections.abc import Sequence as Many

    from hybridreg_ros.benchmark.suite_data import SuiteFrame
    from hybridreg_ros.benchmark.suite_list import Sequence
    from hybridreg_ros.odometry.config import OdometryConfig

F64 = NDArray[np.float64]

_RIDGE = 1.0


@dataclass(frozen=True, eq=False)
class ReportedSamples:
    """Poses of one sequence at one stride as they were reported.

    Attributes:
        sequence: its name.
        features: (P, F) features, in the order of REPORTED.
        right: (P,) whether each pose was right, as a score counts it.
    """

    sequence: str
    features: F64
    right: NDArray[np.bool_]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            'sequence': self.sequence,
            'features': self.features.tolist(),
            'right': self.right.tolist(),
        }

    @staticmethod
    def from_dict(values: dict[str, Any]) -> ReportedSamples:
        """The inverse of `to_dict`."""
        features = np.array(values['features'], np.float64).reshape(-1, len(REPORTED))
        return ReportedSamples(values['sequence'], features, np.array(values['right'], np.bool_))


def gather(
    sequence: Sequence,
    frames: Many[SuiteFrame],
    stride: int,
    config: OdometryConfig,
    model: Any = 'auto',
) -> ReportedSamples:
    """Run the front end as in use and judge each pose that it reports by the truth.

    Args:
        sequence: of the development suite.
        frames: all of them.
        stride: take every n-th.
        config: settings.
        model: the network, as HybridOdometry takes it.
    """
    odometry = HybridOdometry(config, model)
    known: list[tuple[F64, F64]] = []
    features, right = [], []
    for frame in frames[::stride]:
        result = odometry.step(frame.scan)
        here = result.pose, frame.T_world_sensor
        if result.reason is Reason.RECOVERED and result.confidence == 0.0:
            known = [here]  # a new map: the way to it is not known
            continue
        first = not known
        good, known = follow(known, here, sequence.limits)
        if odometry.reported_confidence is not None and not first:
            features.append([getattr(odometry.reported_confidence, name) for name in REPORTED])
            right.append(good)
    return ReportedSamples(
        sequence.name, np.array(features).reshape(-1, len(REPORTED)), np.array(right, np.bool_)
    )


def fit(parts: Many[ReportedSamples]) -> tuple[OdometryCalibration, dict[str, Any]]:
    """Packaged calibration with the confidence fitted anew, and its quality on sequences left out.

    Raises:
        HybridRegError: the poses were all right or all wrong.
    """
    features = np.concatenate([p.features for p in parts])
    right = np.concatenate([p.right for p in parts])
    if len(right) == 0 or right.all() or not right.any():
        raise HybridRegError(f'nothing to fit: {int(right.sum())} of {len(right)} poses are right')
    model = fit_logistic(features, right, ridge=_RIDGE)
    told, truth, most = left_out(parts)
    evident = sigmoid(features[:, REPORTED.index('evident')])
    told = np.minimum(
        told, sigmoid(most[:, REPORTED.index('evident')])
    )  # as `ReportedConfidence.confidence`
    quality = {
        'poses': len(right),
        'right': int(right.sum()),
        'ece_left_out': expected_calibration_error(told, truth) if len(told) else None,
        'above_gate_left_out': _above(told, truth),
        'above_gate_by_evidence': _above(evident, right),
    }
    how = {'how': 'hybridreg replay --suite dev --fit-confidence', **quality}
    kept = packaged()
    found = replace(
        kept,
        confidence=Logistic(model.bias, dict(zip(REPORTED, model.weights.tolist(), strict=True))),
        provenance={**kept.provenance, 'confidence': {**how, **collect().to_dict()}},
    )
    return found, quality


def _above(confidence: F64, right: NDArray[np.bool_]) -> dict[str, int]:
    """How many poses (P,) stand above the gate, and how many of those are wrong."""
    above = confidence >= GateConfig().enter
    return {'poses': int(above.sum()), 'wrong': int((above & ~right).sum())}
