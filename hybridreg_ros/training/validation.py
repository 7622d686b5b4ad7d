# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Scoring a network on held-out pairs while it trains, and one pair's score in detail."""

from __future__ import annotations

import dataclasses
import re
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch.distributed as dist
from scipy.spatial import cKDTree

from hybridreg_ros.core import se3
from hybridreg_ros.data.pair import Label
from hybridreg_ros.metrics import registration
from hybridreg_ros.model.encoded import EncodedCloud
from hybridreg_ros.model.network.matching import select_pairs
from hybridreg_ros.model.pose.verify import view_of
from hybridreg_ros.model.register import HybridReg
from hybridreg_ros.training.report import (
    INDOOR_THRESHOLD_M,
    INDOOR_VOXEL_M,
    OUTDOOR_THRESHOLD_M,
    EvalReport,
    PairScore,
)
from hybridreg_ros.training.samples import Sample, prepare
from hybridreg_ros.training.sources import held_out_pairs

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.pair import PointPair
    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.model.geometry.views import View
    from hybridreg_ros.model.network.output import SuperpointOutput
    from hybridreg_ros.model.reference.network import HybridRegNet
    from hybridreg_ros.model.result import RegistrationResult
    from hybridreg_ros.training.config import TrainConfig

    F32 = NDArray[np.float32]

MATCH_VOXELS = 1.5
SCORED_POINTS = 2000


@dataclass(frozen=True, eq=False)
class Validation:
    """Scores of one validation.

    Attributes:
        report: one score per pair.
    """

    report: EvalReport

    @property
    def selection(self) -> float:
        """What the best weights are chosen by: mean RR before and after the refinement."""
        return 0.5 * (self.report.recall() + self.report.recall(coarse=True))

    def row(self) -> dict[str, Any]:
        """Numbers for validation.csv."""
        last = self.report.rows()[-1]
        by_split = {
            f'RR_{row["split"]}': row['RR'] for row in self.report.rows() if row['split'] != 'all'
        }
        return {k: v for k, v in last.items() if k not in ('split', 'ECE')} | by_split


class ValidationSet:
    """Held-out pairs with their pyramids, built once."""

    def __init__(
        self, config: TrainConfig, model: ModelConfig, rank: int = 0, world: int = 1
    ) -> None:
        self._config, self._model = config, model
        self._rank, self._world = rank, world
        self._held_out: list[HeldOut] | None = None

    def score(self, network: HybridRegNet) -> Validation:
        """Score a network, one attempt a pair; the processes of the run share the pairs."""
        model = HybridReg(dataclasses.replace(network.config, attempts=1), network)
        own = [pair_score(model, held) for held in self.held_out()]
        everything: list[list[PairScore]] = [own]
        if self._world > 1:
            everything = [[] for _ in range(self._world)]
            dist.all_gather_object(everything, own)
        scores = sorted((s for part in everything for s in part), key=lambda s: s.name)
        return Validation(EvalReport('network', tuple(scores)))

    def held_out(self) -> list[HeldOut]:
        """This process's share of the validation pairs."""
        if self._held_out is None:
            c = self._config
            pairs = held_out_pairs(c.validation, c.validation_pairs)[self._rank :: self._world]
            rng = np.random.default_rng(0)
            budget = c.budget.validating()
            self._held_out = [
                HeldOut.of(prepare(p, self._model, c.loss, rng, budget)) for p in pairs
            ]
        return self._held_out


def threshold_m(voxel_size_m: float) -> float:
    """RMSE below which a pair of this sensor counts as registered."""
    return INDOOR_THRESHOLD_M if voxel_size_m < INDOOR_VOXEL_M else OUTDOOR_THRESHOLD_M


def meets(points: F32, others: F32, radius_m: float) -> NDArray[np.bool_]:
    """Whether one of the others (M, 3) lies within the radius of each point (N, 3)."""
    tree = cKDTree(others, balanced_tree=False)
    found: NDArray[np.bool_] = np.isfinite(tree.query(points, distance_upper_bound=radius_m)[0])
    return found


def seen_static(pair: PointPair, points: F32) -> NDArray[np.bool_]:
    """Whether the target has a static point at the place of each of these (K, 3) of the source."""
    static = pair.target[pair.target_label == Label.STATIC]
    moved = se3.apply(pair.T_target_source, points)
    return meets(moved, static, MATCH_VOXELS * pair.voxel_size_m)


def point_mask_auc(pair: PointPair, uncertainty: NDArray[np.float32], seed: int = 0) -> float:
    """AUC of 1 - uncertainty (N,) against 'static and seen', over at most 4,000 source points."""
    rows = np.random.default_rng(seed).permutation(len(pair.source))[: 2 * SCORED_POINTS]
    trusted = (pair.source_label[rows] == Label.STATIC) & seen_static(pair, pair.source[rows])
    return registration.roc_auc(trusted, 1.0 - uncertainty[rows])


def overlap_points(pair: PointPair, seed: int = 0) -> NDArray[np.float32]:
    """At most 2,000 static source points that have a static counterpart in the target, (K, 3)."""
    static = pair.source[pair.source_label == Label.STATIC]
    if len(static) > SCORED_POINTS:
        keep = np.random.default_rng(seed).choice(len(static), SCORED_POINTS, replace=False)
        static = static[keep]
    seen: F32 = static[seen_static(pair, static)]
    return seen


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A sample and the views of its clouds, built once for many validations."""

    sample: Sample
    views: tuple[View, View]

    @classmethod
    def of(cls, sample: Sample) -> HeldOut:
        """Prepare the views of a sample."""
        return cls(sample, (view_of(sample.source), view_of(sample.target)))


def pair_score(model: HybridReg, held: HeldOut) -> PairScore:
    """Register one pair as users do and score the network's own pose and the refined one."""
    sample = held.sample
    began = time.perf_counter()
    source, target = (
        EncodedCloud(model.net.encode(pyramid), view, points)
        for pyramid, view, points in zip(
            (sample.source, sample.target),
            held.views,
            (sample.pair.source, sample.pair.target),
            strict=True,
        )
    )
    first = model.match(source, target)
    full_m = model.config.voxel_factor * sample.pair.voxel_size_m
    result = model.retry(
        first,
        (source, target),
        sample.pair.source,
        sample.pair.target,
        finer_m=full_m if full_m < sample.source.voxel_size_m else None,
    )
    result = model.finely(result, sample.pair.source, sample.pair.target)
    seconds = time.perf_counter() - began
    coarse = model.net.correlate(source.encoding, target.encoding)
    return score_of(sample, (first, result), coarse, model.config, seconds)


def score_of(
    sample: Sample,
    results: tuple[RegistrationResult, RegistrationResult],
    coarse: SuperpointOutput[F32],
    config: ModelConfig,
    seconds: float,
) -> PairScore:
    """Score of one registration.

    Args:
        sample: the pair.
        results: of the first attempt, by which the network's own pose and matches are judged, and
            what the user gets.
        coarse: of the network, first attempt.
        config: sizes of the network.
        seconds: time taken, preparation left out.
    """
    pair, T = sample.pair, sample.pair.T_target_source
    points = overlap_points(pair)
    first, result = results
    matches = first.correspondences
    sigma2 = coarse.source_sigma2, coarse.target_sigma2
    return PairScore(
        name=pair.name,
        split=split_of(pair),
        overlap=float(pair.overlap),
        dynamic_share=float(pair.dynamic_share),
        threshold_m=threshold_m(pair.voxel_size_m),
        rmse_m=registration.rmse_m(T, result.T_target_source, points),
        rre_deg=registration.rotation_error_deg(T, result.T_target_source),
        rte_m=registration.translation_error_m(T, result.T_target_source),
        coarse_rmse_m=registration.rmse_m(T, first.T_lgr, points),
        inlier_ratio=registration.inlier_ratio(
            T, matches.source, matches.target, 2.0 * pair.voxel_size_m
        ),
        coarse_precision=registration.coarse_precision(
            np.asarray(sample.labels.overlap), *select_pairs(coarse, config).T
        ),
        mask_auc=mask_auc(sample, sigma2),
        point_mask_auc=point_mask_auc(pair, result.source_uncertainty),
        confidence=result.confidence,
        seconds=seconds,
        features=tuple(float(f) for f in result.features.vector()),
    )


def mask_auc(sample: Sample, sigma2: tuple[F32, F32]) -> float:
    """AUC of 1 - sigma2 against 'static and seen by the other cloud', both clouds together."""
    trusted = np.concatenate(
        [np.asarray(sample.labels.source_trusted), np.asarray(sample.labels.target_trusted)]
    )
    return registration.roc_auc(trusted > 0.5, 1.0 - np.concatenate(sigma2))


def split_of(pair: PointPair) -> str:
    """Row of the tables of a pair: its name without seed and number, or its folder."""
    seeded = re.fullmatch(r'(.+?)-\d{6,}(-\d+)?', pair.name)
    if seeded:
        return seeded.group(1)
    return pair.name.rsplit('-', 1)[0] or 'pairs'
