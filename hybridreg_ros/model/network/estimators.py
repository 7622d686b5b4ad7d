# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pose from point matches: local-to-global registration (LGR) and RANSAC, in voxels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.jit import compiled, compiled_fast
from hybridreg_ros.core.se3 import aligned

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.config import ModelConfig

    Bool = NDArray[np.bool_]
    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

MIN_MATCHES = 3
_RANSAC_ROUNDS = 2000
_RANSAC_SEED = 7


@dataclass(frozen=True, eq=False)
class PointMatches:
    """Matched fine points of all opened patches.

    Attributes:
        source: (C, 3) float64 points, voxels.
        target: (C, 3) float64.
        weights: (C,) float64 scores in (0, 1].
        patch: (C,) int64 number of the patch pair each match comes from, ascending.
    """

    source: F64
    target: F64
    weights: F64
    patch: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """A pose and how well the matches agree with it.

    Attributes:
        V_target_source: (4, 4) float64, voxels.
        inliers: (C,) bool, matches within the acceptance radius.
        residual: root mean square distance of the inliers, voxels; inf without inliers.
        agreeing: share of the hypotheses whose own matches mostly agree with the final pose.
    """

    V_target_source: F64
    inliers: NDArray[np.bool_]
    residual: float
    agreeing: float


def mutual_matches(
    scores: NDArray[np.float32],
    row_mask: NDArray[np.bool_],
    column_mask: NDArray[np.bool_],
    top: int,
    minimum: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Entries that are among the best `top` of their row and of their column.

    Args:
        scores: (P, K, L) assignment probabilities without dustbins.
        row_mask: (P, K) real rows.
        column_mask: (P, L) real columns.
        top: how many entries of a row or column may match.
        minimum: smallest score of a match.

    Returns:
        Patch, row and column of each match, ordered by patch.
    """
    shape = scores.shape[0], top
    row_floor, column_floor = (np.full((*shape, n), -1.0, np.float32) for n in scores.shape[1:])
    patch, row, column = np.nonzero(
        _mutual(scores, row_mask, column_mask, row_floor, column_floor, minimum)
    )
    return patch, row, column


@compiled
def _mutual(
    scores: F32, row_mask: Bool, column_mask: Bool, rows: F32, columns: F32, minimum: float
) -> Bool:
    """Which entries (P, K, L) match; `rows` (P, top, K) and `columns` (P, top, L) are filled."""
    found = np.zeros(scores.shape, np.bool_)
    for p in range(scores.shape[0]):
        for i in range(scores.shape[1]):
            for j in range(scores.shape[2]):
                s = scores[p, i, j]
                if s > minimum and row_mask[p, i] and column_mask[p, j]:
                    _insert(rows[p, :, i], s)
                    _insert(columns[p, :, j], s)
        for i in range(scores.shape[1]):
            for j in range(scores.shape[2]):
                s = scores[p, i, j]
                if s > minimum and s >= rows[p, -1, i] and s >= columns[p, -1, j]:
                    found[p, i, j] = row_mask[p, i] and column_mask[p, j]
    return found


@compiled
def _insert(best: F32, value: float) -> None:
    """Put a value into its place among the best so far, largest first."""
    k = best.shape[0] - 1
    if value <= best[k]:
        return
    while k > 0 and best[k - 1] < value:
        best[k] = best[k - 1]
        k -= 1
    best[k] = value


def batched_kabsch(source: F64, target: F64, weights: F64) -> F64:
    """Weighted alignment of B sets of matches at once.

    Args:
        source: (B, N, 3).
        target: (B, N, 3).
        weights: (B, N), zero for padding.

    Returns:
        (B, 4, 4) transforms from source to target.
    """
    T: F64 = _aligned(source, target, weights)
    return T


@compiled
def _aligned(source: F64, target: F64, weights: F64) -> F64:
    """The kernel of `batched_kabsch`."""
    T = np.zeros((len(source), 4, 4))
    everywhere = np.zeros((4, 4))
    for b in range(len(source)):
        _, H, s, t = _inlier_moments(everywhere, source[b], target[b], weights[b], np.inf)
        T[b] = aligned(H, s, t)
    return T


def _residuals(T: F64, matches: PointMatches) -> F64:
    """Squared distances (B, C) of all matches under B transforms (B, 4, 4)."""
    moved = matches.source @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
    squared: F64 = ((moved - matches.target) ** 2).sum(axis=2)
    return squared


@compiled_fast
def weighted_inliers(T: F64, source: F64, target: F64, weights: F64, radius: float) -> F64:
    """(B,) sum of the weights of the matches within `radius` under each of B transforms."""
    out, s, t = np.zeros(len(T)), np.ascontiguousarray(source.T), np.ascontiguousarray(target.T)
    for b in range(len(T)):
        pose, total = T[b], 0.0
        for i in range(len(weights)):  # without branches, so that it fills vector registers
            x, y, z = s[0, i], s[1, i], s[2, i]
            dx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3] - t[0, i]
            dy = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3] - t[1, i]
            dz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3] - t[2, i]
            near = dx * dx + dy * dy + dz * dz <= radius * radius
            total += weights[i] if near else 0.0
        out[b] = total
    return out


def patch_hypotheses(matches: PointMatches) -> tuple[F64, NDArray[np.int64]]:
    """One transform per patch pair with at least three matches, and the patches they are of."""
    patches, first, count = np.unique(matches.patch, return_index=True, return_counts=True)
    usable = count >= MIN_MATCHES
    patches, first, count = patches[usable], first[usable], count[usable]
    if len(patches) == 0:
        return np.zeros((0, 4, 4)), patches
    column = np.arange(int(count.max()))
    inside = column[None] < count[:, None]
    rows = np.where(inside, first[:, None] + column[None], 0)
    weights = np.where(inside, matches.weights[rows], 0.0)
    return batched_kabsch(matches.source[rows], matches.target[rows], weights), patches


@compiled
def _inlier_moments(
    T: F64, source: F64, target: F64, weights: F64, radius: float
) -> tuple[int, F64, F64, F64]:
    """Number of the matches within `radius`, their moments (3, 3) and weighted means (3,)."""
    count, total, H = 0, 1e-12, np.zeros((3, 3))
    sum_s, sum_t = np.zeros(3), np.zeros(3)
    for i in range(source.shape[0]):
        s, t = source[i], target[i]
        d2 = 0.0
        for k in range(3):
            gap = T[k, 0] * s[0] + T[k, 1] * s[1] + T[k, 2] * s[2] + T[k, 3] - t[k]
            d2 += gap * gap
        if d2 > radius * radius:
            continue
        count += 1
        total += weights[i]
        for k in range(3):
            sum_s[k] += weights[i] * s[k]
            sum_t[k] += weights[i] * t[k]
            for m in range(3):
                H[k, m] += weights[i] * s[k] * t[m]
    for k in range(3):
        for m in range(3):
            H[k, m] -= sum_s[k] * sum_t[m] / total
    return count, H, sum_s / total, sum_t / total


def refine_pose(T: F64, matches: PointMatches, radius: float, rounds: int) -> F64:
    """Refit a transform (4, 4) to the matches within `radius` of it, `rounds` times."""
    refined: F64 = _refitted(T, matches.source, matches.target, matches.weights, radius, rounds)
    return refined


@compiled
def _refitted(T: F64, source: F64, target: F64, weights: F64, radius: float, rounds: int) -> F64:
    """The kernel of `refine_pose`."""
    for _ in range(rounds):
        count, H, s, t = _inlier_moments(T, source, target, weights, radius)
        if count < MIN_MATCHES:
            break
        T = aligned(H, s, t)
    return T


def lgr(matches: PointMatches, radius: float, rounds: int) -> PoseEstimate:
    """Local-to-global registration: the patch hypothesis with most inliers, refined.

    Args:
        matches: matches in voxels.
        radius: acceptance radius, voxels.
        rounds: refits.
    """
    hypotheses, patches = patch_hypotheses(matches)
    if len(hypotheses) == 0:
        if len(matches.weights) < MIN_MATCHES:
            return _nothing(matches)
        hypotheses = se3.kabsch(matches.source, matches.target, matches.weights)[None]
    ones = np.ones(len(matches.weights))
    agree = weighted_inliers(hypotheses, matches.source, matches.target, ones, radius)
    best = int(np.argmax(agree))
    T = refine_pose(hypotheses[best], matches, radius, rounds)
    return judged(T, matches, radius, patches)


def judged(
    T: F64, matches: PointMatches, radius: float, patches: NDArray[np.int64] | None = None
) -> PoseEstimate:
    """Statistics of a final pose.

    Args:
        T: (4, 4) voxels.
        matches: matches in voxels.
        radius: acceptance radius, voxels.
        patches: the patches that count; None counts those with at least three matches.
    """
    if patches is None:
        numbers, count = np.unique(matches.patch, return_counts=True)
        patches = numbers[count >= MIN_MATCHES]
    squared = _residuals(T[None], matches)[0]
    inlier = squared <= radius * radius
    residual = float(np.sqrt(squared[inlier].mean())) if inlier.any() else float('inf')
    agreeing = 0.0
    if len(patches):
        size = int(patches.max()) + 1
        total = np.bincount(matches.patch, minlength=size)[patches]
        right = np.bincount(matches.patch, weights=inlier, minlength=size)[patches]
        agreeing = float((right > 0.5 * total).mean())
    return PoseEstimate(T, inlier, residual, agreeing)


def _nothing(matches: PointMatches) -> PoseEstimate:
    """The identity, with no inlier: there was nothing to fit."""
    none = np.zeros(len(matches.weights), dtype=bool)
    return PoseEstimate(np.eye(4), none, float('inf'), 0.0)


def ransac(
    matches: PointMatches, radius: float, rounds: int, samples: int = 0, seed: int = _RANSAC_SEED
) -> PoseEstimate:
    """Random triples of matches, the one with most inliers refined.

    Args:
        matches: matches in voxels.
        radius: inlier distance, voxels.
        rounds: refits to the inliers.
        samples: use only the best-scored `samples` matches; 0 uses all.
        seed: of the random triples.
    """
    if samples and samples < len(matches.weights):
        kept = np.sort(np.argsort(-matches.weights, kind='stable')[:samples])
        matches = PointMatches(*(a[kept] for a in vars(matches).values()))
    if len(matches.weights) < MIN_MATCHES:
        return _nothing(matches)
    rng = np.random.default_rng(seed)
    best, most = np.eye(4), -1
    for _ in range(_RANSAC_ROUNDS // 100):
        triples = rng.integers(0, len(matches.weights), size=(100, 3))
        T = batched_kabsch(matches.source[triples], matches.target[triples], np.ones((100, 3)))
        count = (_residuals(T, matches) <= radius * radius).sum(axis=1)
        if int(count.max()) > most:
            best, most = T[int(count.argmax())], int(count.max())
    return judged(
        refine_pose(best, matches, radius, rounds), matches, radius, np.unique(matches.patch)
    )


def estimate_pose(matches: PointMatches, config: ModelConfig) -> PoseEstimate:
    """Pose from the point matches alone: RANSAC where the config says so, otherwise LGR."""
    if config.estimator == 'ransac':
        return ransac(matches, config.acceptance_radius, config.refinements, config.ransac_samples)
    return lgr(matches, config.acceptance_radius, config.refinements)
