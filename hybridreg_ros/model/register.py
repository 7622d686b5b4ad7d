# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""HybridReg: the registration of two clouds as users call it."""

from __future__ import annotations

import dataclasses
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import RegistrationError, WeightsError
from hybridreg_ros.model.budget import Budget
from hybridreg_ros.model.budget import voxel_size_m as chosen_voxel_m
from hybridreg_ros.model.checkpoint import load_checkpoint, packaged_weights
from hybridreg_ros.model.encoded import EncodedCloud
from hybridreg_ros.model.geometry.pyramid import build_pyramid, metric_transform
from hybridreg_ros.model.geometry.upsampling import values_of_inputs
from hybridreg_ros.model.network.estimators import judged
from hybridreg_ros.model.network.forward import Network
from hybridreg_ros.model.network.matching import match
from hybridreg_ros.model.network.output import check_voxels
from hybridreg_ros.model.pose.confidence import PairCalibration, features_of
from hybridreg_ros.model.pose.evidence import evidence_of, trusted_fit
from hybridreg_ros.model.pose.posterior import posterior_sigma2
from hybridreg_ros.model.pose.refine import refine, refined_finely
from hybridreg_ros.model.pose.score import opinions_of
from hybridreg_ros.model.pose.verify import proposals_of, verify, view_of
from hybridreg_ros.model.result import Correspondences, RegistrationResult
from hybridreg_ros.model.retry import (
    exchanged,
    frames_of,
    in_order,
    most_confident,
    rotated,
    rotated_back,
)
from hybridreg_ros.model.static_points import PointMask, point_mask

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.model.network.estimators import PoseEstimate
    from hybridreg_ros.model.network.matching import MatchOutput
    from hybridreg_ros.model.pose.evidence import CloudEvidence
    from hybridreg_ros.model.pose.refine import Refinement
    from hybridreg_ros.model.pose.verify import Verified
    from hybridreg_ros.model.reference.network import HybridRegNet

    Encoded = tuple[EncodedCloud, EncodedCloud]
    F64 = NDArray[np.float64]

_SPEAKERS = 4
"""Points of a finest voxel that are asked whether they are static, in a sequence: the mask of the
front end is not worse for it, at half the cost (docs/lab/2026-11-29-asked-less.md)."""


class HybridReg:
    """Registration of two clouds of a scene in which things may move.

    Examples:
        >>> model = HybridReg.from_pretrained()  # doctest: +SKIP
        >>> model.register(source, target).T_target_source  # doctest: +SKIP
    """

    def __init__(
        self,
        config: ModelConfig,
        net: Network | HybridRegNet,
        calibration: PairCalibration | None = None,
    ) -> None:
        """Wrap a network.

        Args:
            config: sizes, those of `net`, and how it is used.
            net: network; of a torch module its weights of now are taken.
            calibration: of the confidence.
        """
        self.config = config
        self.net = net if isinstance(net, Network) else net.for_use()
        self.calibration = calibration or PairCalibration()
        self.provenance: Mapping[str, object] = {}

    @classmethod
    def from_pretrained(cls, path: str | Path | None = None) -> HybridReg:
        """Load the packaged weights, or those of a file.

        Raises:
            WeightsError: missing, truncated, foreign or unfit weights, or none packaged yet.
        """
        found = load_checkpoint(packaged_weights() if path is None else path)
        model = cls(found.config, Network(found.config, found.weights), found.calibration)
        model.provenance = found.provenance
        return model

    def sequence(self, budget: Budget | None = None) -> SensorSequence:
        """An encoder of clouds of one sensor, whose first cloud chooses the voxel of all."""
        return SensorSequence(self, budget)

    def encode(
        self,
        points: ArrayLike,
        voxel_size_m: float | None = None,
        budget: Budget | None = None,
    ) -> EncodedCloud:
        """Everything about one cloud that does not need the other.

        Args:
            points: (N, 3) sensor frame, metres; rows with NaN or inf are ignored.
            voxel_size_m: finest voxel. None chooses it from this cloud; only clouds of one voxel
                size can be matched, so give it, or use `sequence`.
            budget: by which a voxel that is not given is chosen; None: the full size.

        Raises:
            RegistrationError: too few points, no extent, or coordinates that cannot be metres.
        """
        cloud = _as_cloud(points)
        if voxel_size_m is None:
            voxel_size_m = self._voxel_m(cloud, budget=budget)
        return self._encoded(cloud, float(voxel_size_m))

    def _encoded(self, cloud: NDArray[np.float32], voxel_size_m: float) -> EncodedCloud:
        """One cloud by itself."""
        pyramid = build_pyramid(cloud, voxel_size_m, self.config)
        return EncodedCloud(self.net.encode(pyramid), view_of(pyramid), cloud)

    def _encode_both(
        self, small: NDArray[np.float32], large: NDArray[np.float32], voxel_size_m: float
    ) -> tuple[EncodedCloud, EncodedCloud]:
        """Two clouds side by side; the thread of the small one makes the view of the large."""
        with ThreadPoolExecutor(1) as beside:
            pyramid = beside.submit(build_pyramid, large, voxel_size_m, self.config)
            encoding = beside.submit(lambda: self.net.encode(pyramid.result()))
            first = self._encoded(small, voxel_size_m)
            view = view_of(pyramid.result())
            return first, EncodedCloud(encoding.result(), view, large)

    def _voxel_m(self, *clouds: NDArray[np.float32], budget: Budget | None = None) -> float:
        """Finest voxel for clouds that nobody gave one for, metres."""
        return chosen_voxel_m(*clouds, factor=self.config.voxel_factor, budget=budget)

    def register(
        self,
        source: ArrayLike,
        target: ArrayLike,
        voxel_size_m: float | None = None,
        budget: Budget | None = None,
    ) -> RegistrationResult:
        """Register two clouds, again in other ways while the result leaves doubt.

        Args:
            source: (N, 3) source frame, metres; rows with NaN or inf are allowed.
            target: (M, 3) target frame, metres.
            voxel_size_m: finest voxel; None chooses one from both clouds (0.05 m in rooms, 0.3 m
                in streets, times `ModelConfig.voxel_factor`).
            budget: by which a voxel that is not given is chosen; None: the full size. When the
                attempt within the budget leaves doubt, the next one is made at the full size.

        Raises:
            RegistrationError: a cloud has too few points or no extent, or is not in metres.
        """
        clouds = _as_cloud(source), _as_cloud(target)
        full = self._voxel_m(*clouds) if voxel_size_m is None else float(voxel_size_m)
        voxel = full
        if budget is not None and voxel_size_m is None:
            voxel = self._voxel_m(*clouds, budget=budget)
        first, encoded = self._attempt(*clouds, voxel)
        best = self.retry(first, encoded, *clouds, finer_m=full if full < voxel else None)
        best = self.finely(best, *clouds)
        if not self.config.static_width:
            return best
        source_mask = self.point_mask(*encoded, best.T_target_source)
        target_mask = self.point_mask(*encoded[::-1], se3.inverse(best.T_target_source))
        return dataclasses.replace(
            best,
            source_static_probability=source_mask.static,
            target_static_probability=target_mask.static,
        )

    def point_mask(
        self, source: EncodedCloud, target: EncodedCloud, T_target_source: F64, most: int = 0
    ) -> PointMask:
        """Which points of the source are static, once its pose is known.

        Args:
            source: encoded cloud of N input points.
            target: encoded cloud, in the same voxel size; whether they were matched or not.
            T_target_source: (4, 4), metres.
            most: points of a finest voxel that are asked about, and speak for the others; 0: all.

        Returns:
            P(static) and P(seen by the target's sensor) of the points.

        Raises:
            RegistrationError: they were encoded with different voxel sizes.
            WeightsError: these weights have no static head.
        """
        if not self.config.static_width:
            raise WeightsError('these weights have no static head: use the packaged ones')
        check_voxels(source.encoding, target.encoding)
        return point_mask(self.net, source, target, np.asarray(T_target_source, np.float64), most)

    def retry(
        self,
        first: RegistrationResult,
        encoded: Encoded,
        source: ArrayLike,
        target: ArrayLike,
        finer_m: float | None = None,
    ) -> RegistrationResult:
        """Further attempts at a pair for as long as there is doubt: the other way round, rotated.

        Args:
            first: result of the first attempt; returned as it is when it is `config.sure`.
            encoded: source and target as they were matched in it.
            source: (N, 3) source frame, metres, as for the first attempt.
            target: (M, 3) target frame, metres.
            finer_m: voxel of one attempt at a finer size, made before all others; None: none.
        """
        clouds = _as_cloud(source), _as_cloud(target)

        def turned(R: F64, straight: bool) -> RegistrationResult:
            a, b = (rotated(cloud, R) for cloud in (clouds if straight else clouds[::-1]))
            result = rotated_back(self._attempt(a, b, first.voxel_size_m)[0], R)
            return result if straight else exchanged(result)

        def ways() -> Iterator[Callable[[], RegistrationResult]]:
            if finer_m is not None:
                yield lambda: self._attempt(*clouds, finer_m)[0]
            yield lambda: exchanged(self.match(*encoded[::-1]))
            straight = in_order(*clouds)
            for R in frames_of(*clouds, *(side.view.normals for side in encoded)):
                yield partial(turned, R, straight)

        tried = islice(ways(), self.config.attempts - 1)
        return most_confident(first, tried, self.config.sure)

    def finely(
        self, result: RegistrationResult, source: ArrayLike, target: ArrayLike
    ) -> RegistrationResult:
        """A result with its pose aligned once more, on the points of half the voxel.

        Args:
            result: of `match` or `retry`.
            source: (N, 3) source frame, metres, of which it is.
            target: (M, 3) target frame, metres.
        """
        start, timings = time.perf_counter(), dict(result.timings_s)
        clouds, voxel_m = (_as_cloud(source), _as_cloud(target)), 0.5 * result.voxel_size_m
        T = refined_finely(result.T_target_source, clouds, voxel_m, self.config)
        for stage in ('refine', 'total'):
            timings[stage] += time.perf_counter() - start
        return dataclasses.replace(result, T_target_source=T, timings_s=timings)

    def _attempt(
        self, source: NDArray[np.float32], target: NDArray[np.float32], voxel_size_m: float
    ) -> tuple[RegistrationResult, Encoded]:
        """One registration, both clouds encoded side by side."""
        start = time.perf_counter()
        if len(source) < len(target):
            encoded = self._encode_both(source, target, voxel_size_m)
        else:
            encoded = self._encode_both(target, source, voxel_size_m)[::-1]
        result = self.match(*encoded)
        timings = {
            **result.timings_s,
            'encode': time.perf_counter() - start - result.timings_s['total'],
            'total': time.perf_counter() - start,
        }
        return dataclasses.replace(result, timings_s=timings), encoded

    def match(self, source: EncodedCloud, target: EncodedCloud) -> RegistrationResult:
        """Register two encoded clouds.

        Raises:
            RegistrationError: they were encoded with different voxel sizes.
        """
        start = time.perf_counter()
        views = source.view, target.view
        found = self.matches(source, target)
        middle = time.perf_counter()
        estimate, verified = found.estimate, None
        if self.config.estimator == 'verified':
            matches, proposals = proposals_of(source, target)
            verified = verify(
                proposals,
                estimate.V_target_source,
                matches,
                views,
                opinions_of(source, target, found) if self.config.use_mask else None,
            )
            estimate = judged(
                verified.V_target_source, found.matches, self.config.acceptance_radius
            )
        chosen = time.perf_counter()
        refined = refine(*views, estimate.V_target_source)
        known = evidence_of(source, target, found)
        result = self._result(source, target, found, estimate, refined, verified, known)
        end = time.perf_counter()
        timings = {
            'network': middle - start,
            'verify': chosen - middle,
            'refine': end - chosen,
            'total': end - start,
        }
        return dataclasses.replace(result, timings_s=timings)

    def matches(self, source: EncodedCloud, target: EncodedCloud) -> MatchOutput:
        """What the network alone says of two encoded clouds: point matches, their pose, the mask.

        Raises:
            RegistrationError: they were encoded with different voxel sizes.
        """
        a, b = source.encoding, target.encoding
        return match(a, b, self.net.correlate(a, b), self.net.dustbin, self.config)

    def _result(
        self,
        source: EncodedCloud,
        target: EncodedCloud,
        found: MatchOutput,
        estimate: PoseEstimate,
        refined: Refinement,
        verified: Verified | None,
        evidence: tuple[CloudEvidence, CloudEvidence],
    ) -> RegistrationResult:
        """Everything that users get, without timings."""
        a, b = source.encoding.pyramid, target.encoding.pyramid
        V, views = refined.V_target_source, (source.view, target.view)
        trusted = trusted_fit(V, views, evidence)
        features = features_of(found, estimate, refined, verified, trusted)
        confidence = self.calibration.probability(features)
        sigma2 = (
            posterior_sigma2(evidence[0].sigma2, *views, V, confidence),
            posterior_sigma2(evidence[1].sigma2, *views[::-1], se3.inverse(V), confidence),
        )
        return RegistrationResult(
            metric_transform(V, a, b),
            confidence,
            values_of_inputs(a, sigma2[0]),
            values_of_inputs(b, sigma2[1]),
            Correspondences(found.source_points, found.target_points, found.weights),
            found.T_target_source,
            int(estimate.inliers.sum()),
            a.voxel_size_m,
            features,
        )


def _as_cloud(points: ArrayLike) -> NDArray[np.float32]:
    """Points as (N, 3) float32.

    Raises:
        RegistrationError: another shape, or numbers that are not real.
    """
    cloud = np.asarray(points)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or cloud.dtype.kind not in 'fiu':
        raise RegistrationError(
            f'points: expected real numbers of shape (N, 3), found {cloud.dtype} {cloud.shape}'
        )
    return np.ascontiguousarray(cloud, dtype=np.float32)


class SensorSequence:
    """Clouds of one sensor: the first one chooses the voxel, so that any two can be matched.

    Attributes:
        voxel_size_m: finest voxel, metres; None until a cloud was encoded.
    """

    def __init__(self, model: HybridReg, budget: Budget | None = None) -> None:
        """Begin a sequence.

        Args:
            model: encodes and matches; several sequences may share it.
            budget: by which the first cloud chooses the voxel; None: the full size.
        """
        self._model = model
        self._budget = budget
        self.voxel_size_m: float | None = None

    def encode(self, points: ArrayLike) -> EncodedCloud:
        """`HybridReg.encode` at the voxel of this sequence.

        Raises:
            RegistrationError: too few points, no extent, or coordinates that cannot be metres.
        """
        found = self._model.encode(points, self.voxel_size_m, self._budget)
        self.voxel_size_m = found.voxel_size_m
        return found

    def match(self, source: EncodedCloud, target: EncodedCloud) -> RegistrationResult:
        """`HybridReg.match`.

        Raises:
            RegistrationError: they were encoded with different voxel sizes.
        """
        return self._model.match(source, target)

    def point_mask(
        self, source: EncodedCloud, target: EncodedCloud, T_target_source: F64
    ) -> PointMask:
        """`HybridReg.point_mask`.

        Raises:
            RegistrationError: they were encoded with different voxel sizes.
            WeightsError: the weights have no static head.
        """
        return self._model.point_mask(source, target, T_target_source, _SPEAKERS)
