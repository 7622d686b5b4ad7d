# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fit of confidence and covariance on the development suite; nothing of it is ever scored."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import HybridRegError
from hybridreg_ros.core.provenance import collect
from hybridreg_ros.metrics.calibration import (
    expected_calibration_error,
    fit_logistic,
    sigmoid,
)
from hybridreg_ros.metrics.trajectory import step_errors
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.motion.prediction import Motion
from hybridreg_ros.odometry.result import Reason, Source
from hybridreg_ros.odometry.selection.calibration import (
    EVIDENCE,
    KINDS,
    Logistic,
    OdometryCalibration,
    packaged,
)

if TYPE_CHECKING:
    from collections.abc import Sequence as Many

    from hybridreg_ros.benchmark.suite_data import SuiteFrame
    from hybridreg_ros.benchmark.suite_list import Sequence
    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.selection.candidates import Candidate

F64 = NDArray[np.float64]

_CHI2_6_MEDIAN = 5.348
_SAME_M, _SAME_DEG = 0.01, 0.2
_RIDGE = 1.0
_JOLTS = {'depth': (0.15, 10.0), 'lidar': (1.0, 10.0)}
"""Standard deviation of the error put on predictions: metres and degrees."""


class Jolted(Motion):
    """A motion model whose predictions are off at random.

    Args:
        shift_m: standard deviation of the shift along each axis.
        turn_deg: standard deviation of the turn about each axis.
        seed: of the errors.
    """

    def __init__(self, shift_m: float, turn_deg: float, seed: int) -> None:
        super().__init__()
        self._rng = np.random.default_rng([seed, 31])
        self._spread = np.array([shift_m] * 3 + [np.deg2rad(turn_deg)] * 3)

    def predict(self, stamp: int) -> F64:
        """Pose (4, 4) at a stamp (ns), off."""
        off: F64 = super().predict(stamp) @ se3.exp(self._rng.normal(0.0, self._spread))
        return off


class Labelled(Protocol):
    """Features of poses of one sequence and whether each was right."""

    @property
    def sequence(self) -> str:
        """Its name."""

    @property
    def features(self) -> F64:
        """(P, F) features."""

    @property
    def right(self) -> NDArray[np.bool_]:
        """(P,) whether each pose was right."""


@dataclass(frozen=True, eq=False)
class EvidenceSamples:
    """What one sequence at one stride gives to a fit.

    Attributes:
        sequence: its name.
        features: (P, F) of the poses considered, in the order of EVIDENCE.
        right: (P,) whether each was right.
        nees: (S,) normalised squared errors of right steps (6 degrees of freedom), for the
            covariance scale 1.
    """

    sequence: str
    features: F64
    right: NDArray[np.bool_]
    nees: F64

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            'sequence': self.sequence,
            'features': self.features.tolist(),
            'right': self.right.tolist(),
            'nees': self.nees.tolist(),
        }

    @staticmethod
    def from_dict(values: dict[str, Any]) -> EvidenceSamples:
        """The inverse of `to_dict`."""
        return EvidenceSamples(
            values['sequence'],
            np.array(values['features'], np.float64).reshape(-1, len(EVIDENCE)),
            np.array(values['right'], np.bool_),
            np.array(values['nees'], np.float64),
        )


def gather(
    sequence: Sequence,
    frames: Many[SuiteFrame],
    stride: int,
    base: OdometryConfig,
    jolted: bool = True,
) -> EvidenceSamples:
    """Run without a network and judge each pose that was considered by the truth.

    When jolted, every way of the fallback is tried and the predictions are off on purpose, else
    there would be hardly a wrong pose to learn from. The other runs are as in use, so that the
    share of wrong poses among those that look alike is the usual one.

    A network is left out: its poses are refined in the same map and judged by the same evidence.

    Args:
        sequence: of the development suite.
        frames: all of them.
        stride: take every n-th.
        base: settings.
        jolted: whether predictions are off.
    """
    config = replace(
        base,
        registrar='kiss-icp',
        gate=replace(base.gate, sure=1.0) if jolted else base.gate,
        covariance=replace(base.covariance, scale=1.0),
    )
    off = partial(Jolted, *_JOLTS[sequence.kind], seed=sequence.seed + stride)
    odometry = HybridOdometry(config, model=None, motion=off if jolted else Motion)
    limits = sequence.limits
    known: list[tuple[F64, F64]] = []  # the last right pose and the last one, with their truth
    last: tuple[F64, F64, F64] | None = None
    features, right, nees = [], [], []
    for frame in frames[::stride]:
        result = odometry.step(frame.scan)
        truth = frame.T_world_sensor
        if known:
            for candidate in _distinct(odometry.judged):
                if candidate.is_seen:
                    features.append([getattr(candidate.evidence, name) for name in EVIDENCE])
                    right.append(_right(known, (candidate.reported, truth), limits))
        if result.reason is Reason.RECOVERED and result.confidence == 0.0:
            known, last = [(result.pose, truth)], None  # a new map: the way to it is not known
            continue
        good, known = follow(known, (result.pose, truth), limits)
        if good and result.confidence > 0.0 and result.source is not Source.LOST:
            if last is not None:
                nees.append(_nees(last, (result.pose, truth, result.covariance)))
            last = result.pose, truth, result.covariance
        else:
            last = None
    return EvidenceSamples(
        sequence.name,
        np.array(features).reshape(-1, len(EVIDENCE)),
        np.array(right, np.bool_),
        np.array(nees[1:]),
    )


def _distinct(candidates: list[Candidate]) -> list[Candidate]:
    """Candidates without repetitions of (nearly) the same pose."""
    kept: list[Candidate] = []
    for candidate in candidates:
        offs = [se3.inverse(k.fit.T_odom_sensor) @ candidate.fit.T_odom_sensor for k in kept]
        if not any(
            np.linalg.norm(T[:3, 3]) < _SAME_M and se3.rotation_angle_deg(T[:3, :3]) < _SAME_DEG
            for T in offs
        ):
            kept.append(candidate)
    return kept


def follow(
    known: Many[tuple[F64, F64]], here: tuple[F64, F64], limits: tuple[float, float]
) -> tuple[bool, list[tuple[F64, F64]]]:
    """Whether a pose is right as a score counts it, and what the next one is compared with.

    Args:
        known: the last right pose and the last one, each (4, 4) with its truth (4, 4).
        here: the pose and its truth.
        limits: metres and degrees.
    """
    good = not known or _right(known, here, limits)
    return good, [here if good else known[0], here]


def _right(
    known: Many[tuple[F64, F64]], here: tuple[F64, F64], limits: tuple[float, float]
) -> bool:
    """Whether the way from one of the known poses to this one is right, as a score counts it."""
    for pose, truth in known:
        metres, degrees = step_errors(np.array([pose, here[0]]), np.array([truth, here[1]]))
        if metres[0] <= limits[0] and degrees[0] <= limits[1]:
            return True
    return False


def _nees(last: tuple[F64, F64, F64], here: tuple[F64, F64, F64]) -> float:
    """Normalised squared error of a step; both poses count as independent."""
    step = se3.inverse(last[0]) @ here[0]
    true_step = se3.inverse(last[1]) @ here[1]
    error = se3.log(se3.inverse(true_step) @ step)
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = here[0][:3, :3].T
    spread = turn @ (last[2] + here[2]) @ turn.T
    return float(error @ np.linalg.solve(spread, error))


def fit(parts: Many[EvidenceSamples]) -> tuple[OdometryCalibration, dict[str, Any]]:
    """Evidence and covariance from all parts; how good they are on sequences left out in turn.

    The confidence that is reported follows from the evidence: fit it again afterwards
    (`suite_confidence`).

    Raises:
        HybridRegError: the poses considered were all right or all wrong.
    """
    features = np.concatenate([p.features for p in parts])
    right = np.concatenate([p.right for p in parts])
    if len(right) == 0 or right.all() or not right.any():
        raise HybridRegError(f'nothing to fit: {int(right.sum())} of {len(right)} poses are right')
    model = fit_logistic(features, right, ridge=_RIDGE)
    kinds = {kind: np.concatenate(values) for kind, values in _by_kind(parts).items()}
    missing = [kind for kind in KINDS if len(kinds.get(kind, ())) == 0]
    if missing:
        raise HybridRegError(f'nothing to fit: no right step of a {missing[0]} sequence')
    scale = {kind: float(np.median(values)) / _CHI2_6_MEDIAN for kind, values in kinds.items()}
    quality = {
        'poses': len(right),
        'right': int(right.sum()),
        'ece_left_out': _left_out(parts),
        'steps': {kind: len(values) for kind, values in kinds.items()},
        'nees_mean_scaled': {k: float(np.mean(v) / scale[k] / 6.0) for k, v in kinds.items()},
    }
    how = {'how': 'hybridreg replay --suite dev --fit', **quality, **collect().to_dict()}
    kept = packaged()
    found = OdometryCalibration(
        Logistic(model.bias, dict(zip(EVIDENCE, model.weights.tolist(), strict=True))),
        kept.confidence,
        scale,
        {**kept.provenance, 'evidence': how},
    )
    return found, quality


def _by_kind(parts: Many[EvidenceSamples]) -> dict[str, list[F64]]:
    kinds: dict[str, list[F64]] = {}
    for part in parts:
        kinds.setdefault('lidar' if 'street' in part.sequence else 'depth', []).append(part.nees)
    return kinds


def _left_out(parts: Many[EvidenceSamples]) -> float | None:
    """ECE of confidences, each from a fit that did not see the sequence of the pose."""
    told, truth, _ = left_out(parts)
    if len(told) == 0:
        return None
    ece = expected_calibration_error(told, truth)
    return None if math.isnan(ece) else ece


def left_out(parts: Many[Labelled]) -> tuple[F64, NDArray[np.bool_], F64]:
    """Confidences (P,), each from a fit that did not see the sequence of its pose.

    Returns:
        Them, (P,) truth, and (P, F) features in the same order.
    """
    told, truth, told_of = [], [], []
    for name in sorted({p.sequence for p in parts}):
        rest = [p for p in parts if p.sequence != name]
        outcomes = np.concatenate([p.right for p in rest]) if rest else np.zeros(0, np.bool_)
        if len(outcomes) == 0 or outcomes.all() or not outcomes.any():
            continue
        features = np.concatenate([p.features for p in rest])
        model = fit_logistic(features, outcomes, ridge=_RIDGE)
        for part in parts:
            if part.sequence == name:
                told.append(sigmoid(part.features @ model.weights + model.bias))
                truth.append(part.right)
                told_of.append(part.features)
    if not told:
        return np.zeros(0), np.zeros(0, np.bool_), np.zeros((0, parts[0].features.shape[1]))
    return np.concatenate(told), np.concatenate(truth), np.concatenate(told_of)
