# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is right: superpoint overlaps, fine matches and mask targets from the true transform.

Only static points count. A superpoint that a moving thing covers is never a positive, even where
its surface happens to coincide with something in the other cloud.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from hybridreg_ros.core import se3

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    I64 = NDArray[np.int64]
    Bools = NDArray[np.bool_]

STATIC_SHARE = 0.5
"""A superpoint whose patch is less static than this counts as covered by a moving thing."""


@dataclass(frozen=True, eq=False)
class Patches:
    """Fine points of one cloud and the patches that its superpoints own.

    Attributes:
        points: (F, 3) fine points, sensor frame, in any one unit.
        static: (F,) bool, the fine point lies on the static background.
        index: (S, K) int64 rows of `points` in the patch of each superpoint; F where padded.
    """

    points: F32
    static: Bools
    index: I64


@dataclass(frozen=True, eq=False)
class PairLabels:
    """Everything the losses need to know about one pair.

    Attributes:
        overlap: (S, T) float32, mean share of matched static points of patch i and patch j.
        source_trusted: (S,) float32, share of the patch that is static and seen by the target.
        target_trusted: (T,) float32.
        source_static: (S,) float32, share of the patch that is static.
        target_static: (T,) float32.
        pair_source: (P,) int64, superpoints of the patch pairs for the fine loss.
        pair_target: (P,) int64.
        fine: (P, K+1, K+1) bool, matches inside these patch pairs; last row and column: slack.
        anchors: (A, 2) int64, rows of truly matching fine points.
    """

    overlap: F32
    source_trusted: F32
    target_trusted: F32
    source_static: F32
    target_static: F32
    pair_source: I64
    pair_target: I64
    fine: Bools
    anchors: I64


def pair_labels(
    source: Patches,
    target: Patches,
    T_target_source: F64,
    *,
    radius: float,
    rng: np.random.Generator,
    positive: float = 0.1,
    max_pairs: int = 128,
    max_anchors: int = 256,
) -> PairLabels:
    """Labels of one pair.

    Args:
        source: patches of the source cloud.
        target: patches of the target cloud.
        T_target_source: (4, 4), in the unit of the points.
        radius: fine points closer than this are matches.
        rng: draws patch pairs and anchors when there are more than asked for.
        positive: overlap above which a patch pair may train the fine matcher.
        max_pairs: patch pairs at most.
        max_anchors: matched fine points at most for the descriptor loss.
    """
    moved: F64 = np.asarray(se3.apply(T_target_source, source.points.astype(np.float64)))
    matches = match_matrix(moved, target.points, source.static, target.static, radius)
    member_s, member_t = membership(source), membership(target)
    overlap, static_s, static_t = _overlap(matches, member_s, member_t, source, target)
    seen_s = np.asarray(matches.sum(axis=1)) > 0
    seen_t = np.asarray(matches.sum(axis=0)) > 0
    pair_s, pair_t = _draw_pairs(overlap, positive, max_pairs, rng)
    anchors = _draw_anchors(matches, max_anchors, rng)
    return PairLabels(
        overlap=overlap,
        source_trusted=_patch_mean(member_s, seen_s) * (static_s >= STATIC_SHARE),
        target_trusted=_patch_mean(member_t, seen_t) * (static_t >= STATIC_SHARE),
        source_static=static_s,
        target_static=static_t,
        pair_source=pair_s,
        pair_target=pair_t,
        fine=fine_labels(matches, source.index[pair_s], target.index[pair_t]),
        anchors=anchors,
    )


def match_matrix(
    source_moved: NDArray[np.floating],
    target: NDArray[np.floating],
    source_static: Bools,
    target_static: Bools,
    radius: float,
) -> csr_array:
    """Sparse (F, G) float32 of ones where two static fine points lie within the radius."""
    tree_s = cKDTree(source_moved[source_static], balanced_tree=False)
    tree_t = cKDTree(target[target_static], balanced_tree=False)
    near = tree_s.sparse_distance_matrix(tree_t, radius, output_type='ndarray')
    row = np.flatnonzero(source_static)[near['i']]
    column = np.flatnonzero(target_static)[near['j']]
    ones = np.ones(len(row), np.float32)
    return csr_array((ones, (row, column)), shape=(len(source_moved), len(target)))


def membership(patches: Patches) -> csr_array:
    """Sparse (S, F) float32 of ones where a fine point belongs to a patch."""
    real = patches.index < len(patches.points)
    row = np.nonzero(real)[0]
    column = patches.index[real]
    shape = (len(patches.index), len(patches.points))
    member = csr_array((np.ones(len(row), np.float32), (row, column)), shape=shape)
    member.data[:] = 1.0
    return member


def _overlap(
    matches: csr_array, member_s: csr_array, member_t: csr_array, source: Patches, target: Patches
) -> tuple[F32, F32, F32]:
    """Overlap matrix and the static share of every patch; covered superpoints get overlap 0."""
    reach_t = matches @ member_t.T  # (F, T): matches of a source point inside target patch j
    reach_s = matches.T @ member_s.T  # (G, S)
    reach_t.data[:] = 1.0
    reach_s.data[:] = 1.0
    size_s = np.maximum(np.asarray(member_s.sum(axis=1)), 1.0)
    size_t = np.maximum(np.asarray(member_t.sum(axis=1)), 1.0)
    share_s = (member_s @ reach_t).toarray() / size_s[:, None]
    share_t = (member_t @ reach_s).toarray().T / size_t[None, :]
    static_s = _patch_mean(member_s, source.static)
    static_t = _patch_mean(member_t, target.static)
    covered = (static_s < STATIC_SHARE)[:, None] | (static_t < STATIC_SHARE)[None, :]
    overlap = np.where(covered, 0.0, 0.5 * (share_s + share_t)).astype(np.float32)
    return overlap, static_s, static_t


def _patch_mean(member: csr_array, flag: Bools) -> F32:
    """Share (S,) of the points of each patch that carry a flag (F,)."""
    size = np.maximum(np.asarray(member.sum(axis=1)), 1.0)
    mean: F32 = (np.asarray(member @ flag.astype(np.float32)) / size).astype(np.float32)
    return mean


def fine_labels(matches: csr_array, source_index: I64, target_index: I64) -> Bools:
    """Matches inside patch pairs, slack included.

    Args:
        matches: (F, G) of `match_matrix`.
        source_index: (P, K) fine points of the source patches; F where padded.
        target_index: (P, K) fine points of the target patches; G where padded.

    Returns:
        (P, K+1, K+1) bool. A real point without a match in the other patch matches the slack;
        padded rows and columns, and the corner, are False.
    """
    f, g = matches.shape
    pairs, k = source_index.shape
    dense = np.zeros((f + 1, g + 1), dtype=bool)
    coo = matches.tocoo()
    dense[coo.row, coo.col] = True
    labels = np.zeros((pairs, k + 1, k + 1), dtype=bool)
    inner = dense[source_index[:, :, None], target_index[:, None, :]]
    labels[:, :k, :k] = inner
    labels[:, :k, k] = ~inner.any(axis=2) & (source_index < f)
    labels[:, k, :k] = ~inner.any(axis=1) & (target_index < g)
    return labels


def _draw_pairs(
    overlap: F32, positive: float, limit: int, rng: np.random.Generator
) -> tuple[I64, I64]:
    source, target = np.nonzero(overlap > positive)
    if len(source) > limit:
        chosen = rng.choice(len(source), limit, replace=False)
        source, target = source[chosen], target[chosen]
    return source.astype(np.int64), target.astype(np.int64)


def _draw_anchors(matches: csr_array, limit: int, rng: np.random.Generator) -> I64:
    """At most `limit` matched fine points, (A, 2)."""
    coo = matches.tocoo()
    chosen = rng.permutation(len(coo.row))[:limit]
    return np.stack([coo.row[chosen], coo.col[chosen]], axis=1).astype(np.int64)
