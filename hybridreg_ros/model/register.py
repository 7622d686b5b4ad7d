# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""HybridReg: the registration of two clouds as users call it."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np
import torch

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.model.checkpoint import load_checkpoint, packaged_weights
from hybridreg_ros.model.confidence import Calibration, features_of
from hybridreg_ros.model.estimators import judged
from hybridreg_ros.model.evidence import Evidence, trusted_fit
from hybridreg_ros.model.network import HybridRegNet
from hybridreg_ros.model.posterior import posterior_sigma2
from hybridreg_ros.model.pyramid import build_pyramid, metric_transform
from hybridreg_ros.model.refine import refine
from hybridreg_ros.model.result import Correspondences, EncodedCloud, RegistrationResult
from hybridreg_ros.model.score import Opinion
from hybridreg_ros.model.spread import values_of_inputs
from hybridreg_ros.model.verify import descriptor_matches, propose, verify, view_of
from hybridreg_ros.model.voxel_size import choose_voxel_size_m

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.model.estimators import PoseEstimate
    from hybridreg_ros.model.hypotheses import Candidates
    from hybridreg_ros.model.network import MatchOutput
    from hybridreg_ros.model.refine import Refinement
    from hybridreg_ros.model.verify import Proposals, Verified

    F64 = NDArray[np.float64]


class HybridReg:
    """Registration of two clouds of a scene in which things may move.

    >>> model = HybridReg.from_pretrained()  # doctest: +SKIP
    >>> model.register(source, target).T_target_source  # doctest: +SKIP
    """

    def __init__(
        self,
        config: ModelConfig,
        net: HybridRegNet | None = None,
        calibration: Calibration | None = None,
    ) -> None:
        """Wrap a network; without `net` one with random weights is made (tests, training).

        Args:
            config: sizes; must be that of `net`.
            net: network, put into evaluation mode.
            calibration: of the confidence.
        """
        self.config = config
        self.net = (HybridRegNet(config) if net is None else net).eval()
        self.calibration = calibration or Calibration()
        self.provenance: Mapping[str, object] = {}
        self.voxel_size_m: float | None = None

    @classmethod
    def from_pretrained(cls, path: str | Path | None = None) -> HybridReg:
        """Load the packaged weights, or those of a file.

        Raises:
            WeightsError: missing, truncated, foreign or unfit weights, or none packaged yet.
        """
        checkpoint = load_checkpoint(packaged_weights() if path is None else path)
        model = cls(checkpoint.network.config, checkpoint.network, checkpoint.calibration)
        model.provenance = checkpoint.provenance
        return model

    def encode(self, points: ArrayLike, voxel_size_m: float | None = None) -> EncodedCloud:
        """Everything about one cloud that does not need the other.

        Args:
            points: (N, 3) sensor frame, metres; rows with NaN or inf are ignored.
            voxel_size_m: finest voxel. None chooses it from the first cloud that this object
                encodes without one and keeps it (`self.voxel_size_m`), for only clouds of one
                voxel size can be matched.

        Raises:
            RegistrationError: too few points, no extent, or coordinates that cannot be metres.
        """
        start = time.perf_counter()
        cloud = _as_cloud(points)
        if voxel_size_m is None:
            voxel_size_m = self.voxel_size_m = self.voxel_size_m or self._voxel_m(cloud)
        pyramid = build_pyramid(cloud, float(voxel_size_m), self.config)
        with torch.no_grad():
            encoding = self.net.encode(pyramid)
        return EncodedCloud(encoding, view_of(pyramid), len(cloud), time.perf_counter() - start)

    def _voxel_m(self, *clouds: NDArray[np.float32]) -> float:
        """Finest voxel for clouds that nobody gave one for, metres."""
        return self.config.voxel_factor * choose_voxel_size_m(*clouds)

    def register(
        self, source: ArrayLike, target: ArrayLike, voxel_size_m: float | None = None
    ) -> RegistrationResult:
        """Register two clouds.

        Args:
            source: (N, 3) source frame, metres; rows with NaN or inf are allowed.
            target: (M, 3) target frame, metres.
            voxel_size_m: finest voxel; None chooses one from both clouds (0.05 m in rooms, 0.3 m
                in streets, times `ModelConfig.voxel_factor`).

        Raises:
            RegistrationError: a cloud has too few points or no extent, or is not in metres.
        """
        start = time.perf_counter()
        clouds = _as_cloud(source), _as_cloud(target)
        voxel = self._voxel_m(*clouds) if voxel_size_m is None else float(voxel_size_m)
        with ThreadPoolExecutor(1) as beside:
            second = beside.submit(self.encode, clouds[1], voxel)
            encoded = self.encode(clouds[0], voxel), second.result()
        result = self.match(*encoded)
        timings = {
            **result.timings_s,
            'encode': time.perf_counter() - start - result.timings_s['total'],
            'total': time.perf_counter() - start,
        }
        return _with_timings(result, timings)

    def match(self, source: EncodedCloud, target: EncodedCloud) -> RegistrationResult:
        """Register two encoded clouds.

        Raises:
            RegistrationError: they were encoded with different voxel sizes.
        """
        start = time.perf_counter()
        views = source.view, target.view
        with ThreadPoolExecutor(1) as beside:
            proposed = beside.submit(proposals_of, source, target) if self._verifies else None
            with torch.no_grad():
                found = self.net.match(source.encoding, target.encoding)
            middle = time.perf_counter()
            evidence = beside.submit(_evidence, source, target, found)
            estimate, verified = found.estimate, None
            if proposed is not None:
                matches, proposals = proposed.result()
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
            known = evidence.result()
        result = self._result(source, target, found, estimate, refined, verified, known)
        end = time.perf_counter()
        timings = {
            'network': middle - start,
            'verify': chosen - middle,
            'refine': end - chosen,
            'total': end - start,
        }
        return _with_timings(result, timings)

    @property
    def _verifies(self) -> bool:
        return self.config.estimator == 'verified'

    def _result(
        self,
        source: EncodedCloud,
        target: EncodedCloud,
        found: MatchOutput,
        estimate: PoseEstimate,
        refined: Refinement,
        verified: Verified | None,
        evidence: tuple[Evidence, Evidence],
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


def proposals_of(source: EncodedCloud, target: EncodedCloud) -> tuple[Candidates, Proposals]:
    """Descriptor matches of two clouds and the poses they suggest."""
    matches = descriptor_matches(source.encoding, target.encoding)
    return matches, propose(matches, (source.view, target.view))


def opinions_of(
    source: EncodedCloud, target: EncodedCloud, found: MatchOutput
) -> tuple[Opinion, Opinion]:
    """What the mask says of the points of both clouds by which poses are judged."""
    return (
        Opinion.of(source.view, source.encoding.pyramid, found.source_sigma2, found.source_static),
        Opinion.of(target.view, target.encoding.pyramid, found.target_sigma2, found.target_static),
    )


def _evidence(
    source: EncodedCloud, target: EncodedCloud, found: MatchOutput
) -> tuple[Evidence, Evidence]:
    """What the network knows of the points of both clouds."""
    return (
        Evidence.of(source.encoding, found.source_sigma2),
        Evidence.of(target.encoding, found.target_sigma2),
    )


def _with_timings(result: RegistrationResult, timings: Mapping[str, float]) -> RegistrationResult:
    return RegistrationResult(**{**vars(result), 'timings_s': timings})


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
