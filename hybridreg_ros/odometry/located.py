# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Poses under judgement and poses that passed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hybridreg_ros.odometry.confidence import weakness
from hybridreg_ros.odometry.result import Reason, Source

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.confidence import Evidence, Verdict
    from hybridreg_ros.odometry.config import GateConfig
    from hybridreg_ros.odometry.refine import Fit

    F64 = NDArray[np.float64]
    F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Located:
    """A pose that passed its checks.

    Attributes:
        fit: the pose in the map.
        evidence: what speaks for it.
        source: the branch that made it.
        reason: why that branch.
        confidence: P(pose right), [0, 1].
        evident: the part of it that the evidence alone gives, [0, 1].
        uncertainty: (M,) float32 of the network per map point of the cloud, None without one.
    """

    fit: Fit
    evidence: Evidence
    source: Source
    reason: Reason
    confidence: float
    evident: float
    uncertainty: F32 | None = None

    def adds_to_map(self, gate: GateConfig, voxel_size_m: float) -> bool:
        """Whether the scan enters the map: not in doubt or held loosely where the map shows it."""
        firm = self.evidence.weakness <= weakness(gate.firm * voxel_size_m)
        sure = self.confidence >= gate.write
        return (sure and firm) or self.evidence.overlap < gate.known


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose under judgement; `reported` is it (4, 4) at the instant that is asked for."""

    fit: Fit
    evidence: Evidence
    verdict: Verdict
    reported: F64


def located_by_kiss(found: Candidate, reason: Reason) -> Located:
    """A pose that kiss-icp made; its evidence is all that speaks for it."""
    confidence = found.verdict.confidence
    return Located(found.fit, found.evidence, Source.KISS_ICP, reason, confidence, confidence)
