# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Choosing among many pose hypotheses the one under which the two clouds fit best."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.model.estimators import PointMatches, patch_hypotheses
from hybridreg_ros.model.hypotheses import (
    Candidates,
    consistent_hypotheses,
    distinct,
    weighted_inliers,
)
from hybridreg_ros.model.polish import polished
from hybridreg_ros.model.views import fits, intrusions

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.network import MatchOutput
    from hybridreg_ros.model.pyramid import Pyramid
    from hybridreg_ros.model.views import View

    F64 = NDArray[np.float64]

_FINE_MATCHES = 700
_FINE_TOLERANCE = 2.0
_FINE_NEIGHBOURS = 20
_COARSE_TOLERANCE = 5.0
_COARSE_NEIGHBOURS = 8
_SEEDS = 60
_FINE_RADIUS = 2.0
_COARSE_RADIUS = 5.0
_SPACING = 4.0
_FIT_RADIUS = 1.5
_MARGIN_VOXELS = 3.0
_MARGIN_SHARE = 0.03
_INTRUSION_WEIGHT = 1.0
_WIDE_RADIUS = 3.0
_ROUGH_EVERY = 3
_ROUGH_ROUNDS = (4, 3)
_FINAL_ROUNDS = 6
_AGREEMENT_WEIGHT = 0.3
_PROBES = 24
_FINALISTS = 8


@dataclass(frozen=True, eq=False)
class Verified:
    """The pose that fits best, and by how much.

    Attributes:
        V_target_source: (4, 4) float64, voxels.
        fit: share of both clouds that lies on the other, nearer counts more.
        intrusion: share of both clouds in space that the other cloud's sensor looked through.
        lead: in score over the best pose that differs, as a share of the score; 1 when there is
            no other.
        agreement: share of the superpoint pairs and point matches that agree, mean of both.
        hypotheses: number of poses compared.
    """

    V_target_source: F64
    fit: float
    intrusion: float
    lead: float
    agreement: float
    hypotheses: int


def verify_match(
    found: MatchOutput, pyramids: tuple[Pyramid, Pyramid], views: tuple[View, View]
) -> Verified:
    """The pose under which two clouds fit best, of all that their matches suggest.

    Args:
        found: what the network matched.
        pyramids: source and target.
        views: source and target.
    """
    index = found.candidates.index.cpu().numpy()
    nodes = [p.superpoints.cpu().numpy().astype(np.float64) for p in pyramids]
    superpoints = Candidates(
        nodes[0][index[:, 0]],
        nodes[1][index[:, 1]],
        found.candidates.scores.cpu().numpy().astype(np.float64),
    )
    return verify(found.matches, superpoints, found.estimate.V_target_source, views)


def verify(
    matches: PointMatches,
    superpoints: Candidates,
    first: F64,
    views: tuple[View, View],
) -> Verified:
    """Compare hypotheses from matches and superpoint pairs by how well the clouds fit.

    Args:
        matches: point matches, voxels.
        superpoints: best superpoint pairs, voxels.
        first: (4, 4) a pose to be compared too, that of LGR, voxels.
        views: source and target.
    """
    source, target = views
    rough = source.thinned(_ROUGH_EVERY), target.thinned(_ROUGH_EVERY)
    probes = source.points[:: max(1, len(source.points) // _PROBES)].astype(np.float64)
    poses = _hypotheses(matches, superpoints, first)
    stages = [
        (target.wide, _WIDE_RADIUS, _ROUGH_ROUNDS[0]),
        (target.grid, _FIT_RADIUS, _ROUGH_ROUNDS[1]),
    ]
    compared = len(poses)
    poses = np.concatenate([poses, polished(poses, *rough, stages)])
    rank = _scores(poses, matches, superpoints, rough)
    poses = poses[distinct(poses, rank, probes, _SPACING, _FINALISTS)]
    last = [(target.grid, _FIT_RADIUS, _FINAL_ROUNDS)]
    poses = np.concatenate([poses, polished(poses, source, target, last)])
    scores = _scores(poses, matches, superpoints, views)
    order = distinct(poses, scores, probes, _SPACING, 2)
    T, score = poses[order[0]], max(float(scores[order[0]]), 1e-9)
    lead = 1.0 if len(order) < 2 else min(max(1.0 - float(scores[order[1]]) / score, 0.0), 1.0)
    return Verified(
        T,
        float(fits(T[None], source, target, _FIT_RADIUS)[0]),
        float(intrusions(T[None], source, target, _MARGIN_VOXELS, _MARGIN_SHARE)[0]),
        lead,
        float(_agreement(T[None], matches, superpoints)[0]),
        compared,
    )


def _hypotheses(matches: PointMatches, superpoints: Candidates, first: F64) -> F64:
    """Transforms (B, 4, 4) from consistent matches, consistent superpoints, patches, and LGR."""
    fine = Candidates(matches.source, matches.target, matches.weights).best(_FINE_MATCHES)
    return np.concatenate(
        [
            consistent_hypotheses(fine, _FINE_TOLERANCE, _SEEDS, _FINE_NEIGHBOURS),
            consistent_hypotheses(superpoints, _COARSE_TOLERANCE, _SEEDS, _COARSE_NEIGHBOURS),
            patch_hypotheses(matches)[0],
            first[None],
        ]
    )


def _agreement(T: F64, matches: PointMatches, superpoints: Candidates) -> F64:
    """Share of the point matches' weight and of the superpoint pairs that agree, their mean."""
    total = np.zeros(len(T))
    for m, weights, radius in (
        (matches, matches.weights, _FINE_RADIUS),
        (superpoints, np.ones(len(superpoints.weights)), _COARSE_RADIUS),
    ):
        if len(weights):
            found = weighted_inliers(T, m.source, m.target, weights, radius)
            total += 0.5 * found / max(float(weights.sum()), 1e-12)
    return total


def _scores(
    T: F64, matches: PointMatches, superpoints: Candidates, views: tuple[View, View]
) -> F64:
    """What decides between poses, (B,): fit and agreement less the intrusion into free space."""
    found: F64 = (
        fits(T, *views, _FIT_RADIUS)
        + _AGREEMENT_WEIGHT * _agreement(T, matches, superpoints)
        - _INTRUSION_WEIGHT * intrusions(T, *views, _MARGIN_VOXELS, _MARGIN_SHARE)
    )
    return found
