# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fitting what decides between poses: the weights of `model.score` from pairs with known poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize

from hybridreg_ros.metrics import registration
from hybridreg_ros.model.geometry.pyramid import metric_transform
from hybridreg_ros.model.pose.score import TRACES, Opinion, opinions_of, traces
from hybridreg_ros.model.pose.verify import finalists, proposals_of
from hybridreg_ros.training.validation import overlap_points, threshold_m

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.data.pair import PointPair
    from hybridreg_ros.model.register import HybridReg

    F64 = NDArray[np.float64]
    Bool = NDArray[np.bool_]

REGULARISATION = 0.002
"""Of the weights of standardised traces."""


@dataclass(frozen=True, eq=False)
class Contest:
    """The poses among which one is chosen, of one pair.

    Attributes:
        scene: pairs of one scene belong together in cross-validation.
        traces: (B, 8), see `model.score.TRACES`.
        right: (B,) bool, the pose registers the pair.
    """

    scene: str
    traces: F64
    right: Bool


def contest(model: HybridReg, pair: PointPair) -> Contest:
    """What the verification of a pair has to choose from; without a mask if the model uses none.

    Raises:
        RegistrationError: a cloud has too few points.
    """
    voxel_m = model.config.voxel_factor * pair.voxel_size_m
    source, target = model.encode(pair.source, voxel_m), model.encode(pair.target, voxel_m)
    found = model.matches(source, target)
    matches, proposals = proposals_of(source, target)
    views = source.view, target.view
    poses = finalists(proposals, found.estimate.V_target_source, matches, views)
    pyramids = source.encoding.pyramid, target.encoding.pyramid
    points = overlap_points(pair)
    off_m = [
        registration.rmse_m(pair.T_target_source, metric_transform(V, *pyramids), points)
        for V in poses
    ]
    opinions = Opinion.none(views[0]), Opinion.none(views[1])
    if model.config.use_mask:
        opinions = opinions_of(source, target, found)
    return Contest(
        pair.name.rsplit('-', 1)[0],
        traces(poses, matches, views, opinions),
        np.array(off_m) < threshold_m(pair.voxel_size_m),
    )


def fit_weights(contests: Sequence[Contest]) -> F64:
    """Weights (8,) under which right poses are most likely, a softmax over each contest.

    Contests that cannot be won or lost are left out.

    Raises:
        ValueError: there is no other contest.
    """
    used = [c for c in contests if c.right.any() and not c.right.all()]
    if not used:
        raise ValueError(
            'no pair has right and wrong poses to choose from: give more pairs, with less overlap'
        )
    scale = np.concatenate([c.traces for c in used]).std(axis=0) + 1e-9

    def loss(w: F64) -> tuple[float, F64]:
        total, slope = 0.0, np.zeros_like(w)
        for c in used:
            x = c.traces / scale
            p = _softmax(x @ w)
            won = float(p[c.right].sum())
            total -= float(np.log(won + 1e-12))
            slope -= x.T @ (p * c.right / max(won, 1e-12) - p)
        n = len(used)
        return total / n + REGULARISATION * float(w @ w), slope / n + 2.0 * REGULARISATION * w

    best = minimize(loss, np.zeros(len(TRACES)), jac=True, method='L-BFGS-B').x
    weights: F64 = best / scale
    return weights


def _softmax(x: F64) -> F64:
    p = np.exp(x - x.max())
    shares: F64 = p / p.sum()
    return shares


def won(contests: Sequence[Contest], weights: F64) -> Bool:
    """Whether the best pose under the weights (8,) is right, for each contest."""
    return np.array([bool(c.right[np.argmax(c.traces @ weights)]) for c in contests])


def held_out_wins(contests: Sequence[Contest], folds: int = 5) -> Bool:
    """`won` by weights that were fitted to other scenes."""
    scenes = {name: i % folds for i, name in enumerate(sorted({c.scene for c in contests}))}
    out = np.zeros(len(contests), bool)
    fold = np.array([scenes[c.scene] for c in contests])
    for k in range(folds):
        weights = fit_weights([c for c, f in zip(contests, fold, strict=True) if f != k])
        out[fold == k] = won([c for c, f in zip(contests, fold, strict=True) if f == k], weights)
    return out
