# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Choosing among many pose hypotheses the one under which the two clouds fit best."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.model.geometry.views import View, fits, intrusions
from hybridreg_ros.model.network.descriptors import MATCH_TEMPERATURE, likely_pairs
from hybridreg_ros.model.network.estimators import weighted_inliers
from hybridreg_ros.model.pose.hypotheses import Candidates, consistent_hypotheses, distinct
from hybridreg_ros.model.pose.plane_icp import plane_icp
from hybridreg_ros.model.pose.score import (
    AGREEMENT_RADIUS,
    FIT_RADIUS,
    MARGIN_SHARE,
    MARGIN_VOXELS,
    TRACES,
    Opinion,
    scores,
    traces,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.encoded import EncodedCloud
    from hybridreg_ros.model.geometry.pyramid import Pyramid
    from hybridreg_ros.model.network.output import Encoding

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

_MATCHES = 300
_TOLERANCE = 2.0
_NEIGHBOURS = 20
_SEEDS = 60
_SPACING = 4.0
_INTRUSION_WEIGHT = 3.0
_WIDE_RADIUS = 3.0
_ROUGH_EVERY = 3
_ROUGH_ROUNDS = (4, 3)
_FINAL_ROUNDS = 6
_AGREEMENT_WEIGHT = 0.5
_PROBES = 24
_FINALISTS = 8
_SAME = 1.0
"""Hypotheses nearer to each other, in voxels, are one: where most matches agree, 60 are one to
twenty, and need not be aligned one by one (docs/lab/2026-11-30-counted-references.md)."""
_ALIGNED = 24
"""Poses that are aligned roughly: those that fit best before (docs/lab, 2026-11-29)."""


@dataclass(frozen=True, eq=False)
class Verified:
    """The pose that fits best, and by how much.

    Attributes:
        V_target_source: (4, 4) float64, voxels.
        fit: share of both clouds that lies on the other, nearer counts more.
        intrusion: share of both clouds in space that the other cloud's sensor looked through.
        lead: over the best pose that differs, 1 less the ratio of their odds; 1 when there is no
            other.
        agreement: share of the descriptor matches that agree.
        matched: number of descriptor matches that agree.
    """

    V_target_source: F64
    fit: float
    intrusion: float
    lead: float
    agreement: float
    matched: int


@dataclass(frozen=True, eq=False)
class Proposals:
    """Poses that may be right.

    Attributes:
        poses: (B, 4, 4) transforms, voxels.
        rank: (B,) rough score of each, larger = better.
    """

    poses: F64
    rank: F64


def view_of(pyramid: Pyramid) -> View:
    """A cloud's finest level, prepared for judging and refining poses."""
    sensor = -pyramid.origin_m / pyramid.voxel_size_m
    return View.build(pyramid.levels[0].points, pyramid.normals, sensor)


def descriptor_matches(source: Encoding[F32], target: Encoding[F32]) -> Candidates:
    """The fine points most likely to be the same, whatever their superpoints, voxels."""
    rows, likelihood = likely_pairs(
        source.fine_features, target.fine_features, _MATCHES, MATCH_TEMPERATURE
    )
    return Candidates(
        source.pyramid.fine_points[rows[:, 0]].astype(np.float64),
        target.pyramid.fine_points[rows[:, 1]].astype(np.float64),
        likelihood.astype(np.float64),
    )


def propose(matches: Candidates, views: tuple[View, View]) -> Proposals:
    """Poses that groups of consistent matches suggest, as they are and roughly aligned.

    Args:
        matches: descriptor matches of fine points, voxels.
        views: source and target.
    """
    poses = consistent_hypotheses(matches, _TOLERANCE, _SEEDS, _NEIGHBOURS)
    order = -np.arange(len(poses), dtype=np.float64)  # most support first
    poses = poses[distinct(poses, order, _probes(views[0]), _SAME, _SEEDS)]
    return _ranked(poses, matches, views)


def proposals_of(source: EncodedCloud, target: EncodedCloud) -> tuple[Candidates, Proposals]:
    """Descriptor matches of two clouds and the poses they suggest."""
    matches = descriptor_matches(source.encoding, target.encoding)
    return matches, propose(matches, (source.view, target.view))


def _ranked(poses: F64, matches: Candidates, views: tuple[View, View]) -> Proposals:
    """Poses (B, 4, 4) and the best of them after a few rounds, judged on thinned clouds."""
    source, target = (view.thinned(_ROUGH_EVERY) for view in views)
    stages = [
        (target.wide, _WIDE_RADIUS, _ROUGH_ROUNDS[0]),
        (target.grid, FIT_RADIUS, _ROUGH_ROUNDS[1]),
    ]
    rank = _rough_scores(poses, matches, (source, target))
    best = np.sort(np.argsort(-rank, kind='stable')[:_ALIGNED])
    moved = plane_icp(poses[best], source, target, stages)
    return Proposals(
        np.concatenate([poses, moved]),
        np.concatenate([rank, _rough_scores(moved, matches, (source, target))]),
    )


def finalists(
    proposals: Proposals, first: F64, matches: Candidates, views: tuple[View, View]
) -> F64:
    """The best poses that differ, (B, 4, 4), then the same after a fine alignment.

    Args:
        proposals: from `propose`.
        first: (4, 4) a pose to be compared too, that of LGR, voxels.
        matches: descriptor matches of fine points, voxels.
        views: source and target.
    """
    source, target = views
    given = _ranked(first[None], matches, views)
    poses = np.concatenate([proposals.poses, given.poses])
    rank = np.concatenate([proposals.rank, given.rank])
    poses = poses[distinct(poses, rank, _probes(source), _SPACING, _FINALISTS)]
    last = [(target.grid, FIT_RADIUS, _FINAL_ROUNDS)]
    return np.concatenate([poses, plane_icp(poses, source, target, last)])


def _probes(view: View) -> F64:
    """A few points of a view, by which poses are told apart."""
    return view.points[:: max(1, len(view.points) // _PROBES)].astype(np.float64)


def verify(
    proposals: Proposals,
    first: F64,
    matches: Candidates,
    views: tuple[View, View],
    opinions: tuple[Opinion, Opinion] | None = None,
) -> Verified:
    """The pose under which two clouds fit best.

    Args:
        proposals: from `propose`.
        first: (4, 4) a pose to be compared too, that of LGR, voxels.
        matches: descriptor matches of fine points, voxels.
        views: source and target.
        opinions: of the mask; None: all points count the same.
    """
    poses = finalists(proposals, first, matches, views)
    known = opinions or (Opinion.none(views[0]), Opinion.none(views[1]))
    found = traces(poses, matches, views, known)
    odds = scores(found, masked=opinions is not None)
    order = distinct(poses, odds, _probes(views[0]), _SPACING, 2)
    T = poses[order[0]]
    lead = 1.0 if len(order) < 2 else 1.0 - float(np.exp(odds[order[1]] - odds[order[0]]))
    matched = _matched(T[None], matches)[0]
    return Verified(
        T,
        float(found[order[0], TRACES.index('fit')]),
        float(intrusions(T[None], *views, MARGIN_VOXELS, MARGIN_SHARE)[0]),
        lead,
        float(matched / max(len(matches.weights), 1)),
        int(matched),
    )


def _matched(T: F64, matches: Candidates) -> F64:
    """Number of matches that agree with each of B transforms, (B,)."""
    ones = np.ones(len(matches.weights))
    found: F64 = weighted_inliers(T, matches.source, matches.target, ones, AGREEMENT_RADIUS)
    return found


def _rough_scores(T: F64, matches: Candidates, views: tuple[View, View]) -> F64:
    """What decides between rough poses, (B,): fit and agreement less the intrusion."""
    share = _matched(T, matches) / max(len(matches.weights), 1)
    found: F64 = (
        fits(T, *views, FIT_RADIUS)
        + _AGREEMENT_WEIGHT * share
        - _INTRUSION_WEIGHT * intrusions(T, *views, MARGIN_VOXELS, MARGIN_SHARE)
    )
    return found
