# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pose hypotheses from matches that agree in their distances, for matches mostly wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.model.network.estimators import batched_kabsch

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    I64 = NDArray[np.int64]

_SEED_SPACING_VOXELS = 4.0
_MIN_MATCHES = 3


@dataclass(frozen=True, eq=False)
class Candidates:
    """Matches that may be right, of points or of superpoints.

    Attributes:
        source: (C, 3) float64, voxels.
        target: (C, 3) float64, voxels.
        weights: (C,) float64, larger = more likely right.
    """

    source: F64
    target: F64
    weights: F64


@compiled
def _compatibility(source: F64, target: F64, tolerance: float) -> F32:
    """(C, C) float32: how well two matches keep their distance, 1 = exactly, 0 = not at all."""
    n = source.shape[0]
    out = np.zeros((n, n), np.float32)
    for i in range(n):
        for j in range(i):
            a = b = 0.0
            for k in range(3):
                a += (source[i, k] - source[j, k]) ** 2
                b += (target[i, k] - target[j, k]) ** 2
            gap = abs(np.sqrt(a) - np.sqrt(b)) / tolerance
            if gap < 1.0:
                out[i, j] = out[j, i] = 1.0 - gap * gap
    return out


@compiled
def _spread_seeds(order: I64, source: F64, target: F64, count: int, spacing: float) -> I64:
    """The first `count` of `order` that are not near an earlier one in both clouds."""
    kept = np.empty(count, np.int64)
    found = 0
    s2 = spacing * spacing
    for i in order:
        free = True
        for k in kept[:found]:
            a = b = 0.0
            for c in range(3):
                a += (source[i, c] - source[k, c]) ** 2
                b += (target[i, c] - target[k, c]) ** 2
            if a < s2 and b < s2:
                free = False
                break
        if free:
            kept[found] = i
            found += 1
            if found == count:
                break
    return kept[:found]


def consistent_hypotheses(
    matches: Candidates, tolerance: float, seeds: int, neighbours: int
) -> F64:
    """One transform per seed match, from the matches most consistent with it.

    Two matches are compatible when both clouds hold their points equally far apart; two
    compatible matches support each other by the compatibility they share with all others. Seeds
    are the matches with most support, spread over the clouds.

    Args:
        matches: candidates, voxels.
        tolerance: difference of distances at which two matches stop being compatible, voxels.
        seeds: most hypotheses.
        neighbours: matches per hypothesis, the seed included.

    Returns:
        (B, 4, 4) transforms; B is 0 for fewer than three matches.
    """
    if len(matches.weights) < _MIN_MATCHES:
        return np.zeros((0, 4, 4))
    first = _compatibility(matches.source, matches.target, tolerance)
    second = first * (first @ first)
    order = np.argsort(-second.sum(axis=1), kind='stable')
    chosen = _spread_seeds(order, matches.source, matches.target, seeds, _SEED_SPACING_VOXELS)
    support = second[chosen].astype(np.float64)
    near = np.argsort(-support, axis=1, kind='stable')[:, : neighbours - 1]
    weight = np.take_along_axis(support, near, 1)
    weight /= np.maximum(weight[:, :1], 1e-12)
    rows = np.concatenate([chosen[:, None], near], axis=1)
    weight = np.concatenate([np.ones((len(chosen), 1)), weight], axis=1)
    usable = (weight > 0.0).sum(axis=1) >= _MIN_MATCHES
    rows, weight = rows[usable], weight[usable]
    return batched_kabsch(matches.source[rows], matches.target[rows], weight)


def distinct(T: F64, scores: F64, points: F64, spacing: float, count: int) -> I64:
    """The best of B transforms that move `points` by more than `spacing` from better ones.

    Args:
        T: (B, 4, 4).
        scores: (B,) larger = better.
        points: (K, 3) where the difference of two transforms is measured, as a mean.
        spacing: smallest difference of two that are kept.
        count: most that are kept.

    Returns:
        At most `count` rows of T, best first.
    """
    moved = points @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
    found: I64 = _apart(moved, np.argsort(-scores, kind='stable'), spacing, count)
    return found


@compiled
def _apart(moved: F64, order: I64, spacing: float, count: int) -> I64:
    """The first `count` of `order` whose points (B, K, 3) are not near those of an earlier one."""
    kept = np.empty(count, np.int64)
    found = 0
    for i in order:
        free = True
        for k in kept[:found]:
            total = 0.0
            for p in range(moved.shape[1]):
                d2 = 0.0
                for c in range(3):
                    d2 += (moved[i, p, c] - moved[k, p, c]) ** 2
                total += np.sqrt(d2)
            if total < spacing * moved.shape[1]:
                free = False
                break
        if free:
            kept[found] = i
            found += 1
            if found == count:
                break
    return kept[:found]
