# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Locator: which branch gives the pose of a scan, checked by what the scan sees there."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.odometry.confidence import Evidence, Gate, Verdict, judge
from hybridreg_ros.odometry.fallback import Fallback, turned
from hybridreg_ros.odometry.refine import Fit, refine
from hybridreg_ros.odometry.result import Reason, Source

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.keyframes import Keyframes
    from hybridreg_ros.odometry.learned import LearnedBranch, Proposal
    from hybridreg_ros.odometry.localmap import LocalMap
    from hybridreg_ros.odometry.preprocess import Cloud, SensorModel
    from hybridreg_ros.odometry.visibility import Sightings

    F64 = NDArray[np.float64]
    F32 = NDArray[np.float32]

_log = logging.getLogger(__name__)


class Watch(Protocol):
    """Books the time of a stage."""

    def lap(self, stage: str) -> None:
        """Book the time since the last lap under a stage."""


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
        uncertainty: (N,) float32 of the network per point of the cloud, None without one.
    """

    fit: Fit
    evidence: Evidence
    source: Source
    reason: Reason
    confidence: float
    evident: float
    uncertainty: F32 | None = None


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A pose under judgement."""

    fit: Fit
    evidence: Evidence
    verdict: Verdict


class Locator:
    """The two branches behind one question: where is this scan?

    Args:
        config: settings.
        sensor: what the sensor is.
        local_map: the map of both branches.
        learned: the network branch, or None.
        keyframes: what the network matches against.
        sightings: what earlier scans saw.
    """

    def __init__(
        self,
        config: OdometryConfig,
        sensor: SensorModel,
        local_map: LocalMap,
        learned: LearnedBranch | None,
        keyframes: Keyframes,
        sightings: Sightings,
    ) -> None:
        self._config = config
        self._voxel_m = sensor.voxel_size_m
        self._map = local_map
        self._learned = learned
        self._keyframes = keyframes
        self._sightings = sightings
        self._fallback = Fallback(config, sensor, local_map)
        self._gate = Gate(config.gate)
        self._no_network = (
            Reason.REGISTRAR_KISS_ICP if config.registrar == 'kiss-icp' else Reason.NO_WEIGHTS
        )
        self.learn = self._fallback.learn
        self.update = self._fallback.update

    def locate(
        self,
        cloud: Cloud,
        predicted: F64,
        last: F64,
        dt_s: float,
        encoding: Any,
        trust: F32,
        watch: Watch,
    ) -> Located | Reason:
        """Pose by the network when it is trusted, else by the fallback; or why there is none.

        Args:
            cloud: the preprocessed scan.
            predicted: (4, 4) pose by constant velocity.
            last: (4, 4) last pose.
            dt_s: seconds since then.
            encoding: of the scan by the network, or None.
            trust: (K,) weight per registered point.
            watch: books the time per stage.
        """
        check = partial(self._judged, cloud, trust, predicted, dt_s)
        if self._learned is None:
            return self._by_fallback(cloud, [predicted, last], trust, check, self._no_network)
        proposal = self._learned.propose(encoding, self._keyframes.to_match(predicted))
        watch.lap('match')
        found = self._by_network(cloud, proposal, trust, check)
        watch.lap('refine')
        if isinstance(found, Reason):
            return self._by_fallback(cloud, [predicted, last], trust, check, found)
        if found.evident >= self._config.fallback.sure:
            return found
        # The network is confident, but the scan stands badly there: ask for another opinion.
        other = self._by_fallback(cloud, [predicted, last], trust, check, Reason.REFINEMENT_FAILED)
        better = isinstance(other, Located) and other.evident > found.evident
        return other if better else found

    def relocate(self, cloud: Cloud, last: F64, encoding: Any) -> Located | Reason:
        """Pose of a scan when the last pose says little: by the fallback, then by keyframes.

        Args:
            cloud: the preprocessed scan.
            last: (4, 4) last pose before the loss.
            encoding: of the scan by the network, or None.
        """
        trust = np.ones(len(cloud.icp_rows), np.float32)
        check = partial(self._judged, cloud, trust, None, 0.0)
        found = self._by_fallback(cloud, [last], trust, check, Reason.RECOVERED)
        if isinstance(found, Located) and found.confidence >= self._config.fallback.sure:
            return found
        if self._learned is not None:
            for keyframe in self._keyframes.nearest(last, self._config.lost.keyframes_tried):
                proposal = self._learned.propose(encoding, keyframe)
                by_network = self._by_network(cloud, proposal, trust, check)
                if isinstance(by_network, Located):
                    return by_network
        return Reason.LOW_CONFIDENCE if isinstance(found, Located) else found

    def _by_network(
        self,
        cloud: Cloud,
        proposal: Proposal | None,
        trust: F32,
        check: Callable[[Fit], _Candidate],
    ) -> Located | Reason:
        """The network's pose, refined in the map; or why it is not taken."""
        if proposal is None or not self._gate.passes(proposal.confidence):
            return Reason.LOW_CONFIDENCE
        weights = trust * (1.0 - proposal.uncertainty)
        fit = refine(
            cloud.icp_points,
            proposal.T_odom_sensor,
            self._map,
            self._config.refine,
            weights,
            'middle',
        )
        candidate = check(fit)
        if candidate.verdict.fault is not None:
            return candidate.verdict.fault
        if candidate.verdict.confidence < self._config.fallback.accept:
            return Reason.REFINEMENT_FAILED
        return Located(
            fit,
            candidate.evidence,
            Source.HYBRIDREG,
            Reason.OK,
            min(proposal.confidence, candidate.verdict.confidence),
            candidate.verdict.confidence,
            cloud.spread(proposal.uncertainty),
        )

    def _by_fallback(
        self,
        cloud: Cloud,
        guesses: Sequence[F64],
        trust: F32,
        check: Callable[[Fit], _Candidate],
        reason: Reason,
    ) -> Located | Reason:
        """Fallback from the guesses; while in doubt, other ways and turned guesses. Best wins."""
        section, locate = self._config.fallback, self._fallback.locate
        attempts: list[Callable[[], Fit]] = [
            partial(self._fallback.follow, cloud, guesses[0], trust),
            partial(locate, cloud, guesses, trust),
            partial(self._fallback.second_opinion, cloud, guesses[0], trust),
        ]
        attempts += [
            partial(locate, cloud, turned(guesses[0], a), trust) for a in section.turns_deg
        ]
        if section.engine == 'kiss-icp':
            attempts = attempts[1:2]
        best: _Candidate | None = None
        for tried, attempt in enumerate(attempts):
            try:
                found = check(attempt())
            except RegistrationError as error:
                _log.debug('fallback: %s', error)
                continue
            if best is None or found.verdict.confidence > best.verdict.confidence:
                best = found
            if best.verdict.confidence >= (section.sure if tried == 0 else section.good):
                break
        if best is None:
            return Reason.REFINEMENT_FAILED
        if best.verdict.fault is not None:
            return best.verdict.fault
        if best.verdict.confidence < section.accept:
            return Reason.LOW_CONFIDENCE
        return Located(
            best.fit,
            best.evidence,
            Source.KISS_ICP,
            reason,
            best.verdict.confidence,
            best.verdict.confidence,
        )

    def _judged(
        self, cloud: Cloud, trust: F32, predicted: F64 | None, dt_s: float, fit: Fit
    ) -> _Candidate:
        """A pose with what speaks for it, judged by the points that do not move."""
        points = cloud.icp_points[trust > 0.5]
        evidence = self._sightings.evidence(points, fit.T_odom_sensor, fit.overlap)
        verdict = judge(
            evidence, fit.T_odom_sensor, predicted, dt_s, self._voxel_m, self._config.gate
        )
        return _Candidate(fit, evidence, verdict)
