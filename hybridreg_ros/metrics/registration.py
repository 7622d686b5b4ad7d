# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Registration metrics: RRE (deg), RTE (m), RMSE, RR, inlier ratio, FMR, coarse precision, AUC."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]
    Points = NDArray[np.floating]

RMSE_THRESHOLD_M = 0.2
"""A registration counts when its RMSE over ground-truth correspondences is below this."""
INLIER_THRESHOLD_M = 0.1
"""A correspondence is an inlier below this distance under the true transform."""
FMR_THRESHOLD = 0.05
"""Feature matching recall counts pairs whose inlier ratio is above this."""


def rotation_error_deg(T_true: F64, T_estimate: F64) -> float:
    """RRE: angle between two rotations, degrees in [0, 180].

    Args:
        T_true: (4, 4).
        T_estimate: (4, 4).

    Examples:
        >>> import numpy as np
        >>> T = np.eye(4); T[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
        >>> round(rotation_error_deg(np.eye(4), T), 6)
        90.0
    """
    return se3.rotation_angle_deg(T_true[:3, :3].T @ T_estimate[:3, :3])


def translation_error_m(T_true: F64, T_estimate: F64) -> float:
    """RTE: distance between the translations of two transforms (4, 4), metres.

    Examples:
        >>> import numpy as np
        >>> T = np.eye(4); T[:3, 3] = [3.0, 0.0, 4.0]
        >>> translation_error_m(np.eye(4), T)
        5.0
    """
    return float(np.linalg.norm(T_true[:3, 3] - T_estimate[:3, 3]))


def rmse_m(T_true: F64, T_estimate: F64, points: Points) -> float:
    """RMSE between two placements of the same points, metres.

    Args:
        T_true: (4, 4) T_target_source.
        T_estimate: (4, 4) T_target_source.
        points: (N, 3) source points that have a ground-truth correspondence (static, overlapping).

    Returns:
        The error; inf when there is no point to measure it on.

    Examples:
        >>> import numpy as np
        >>> T = np.eye(4); T[0, 3] = 0.5
        >>> rmse_m(np.eye(4), T, np.ones((4, 3)))
        0.5
    """
    if len(points) == 0:
        return float('inf')
    p = np.asarray(points, dtype=np.float64)
    d = se3.apply(T_true, p) - se3.apply(T_estimate, p)
    return float(np.sqrt(np.mean(np.sum(d * d, axis=1))))


def residuals_m(T_true: F64, source: Points, target: Points) -> F64:
    """Distance of each correspondence under a transform.

    Args:
        T_true: (4, 4) T_target_source.
        source: (K, 3) source frame, metres.
        target: (K, 3) target frame, metres; row i belongs to row i of `source`.

    Returns:
        (K,) metres.

    Examples:
        >>> residuals_m(np.eye(4), np.zeros((1, 3)), np.array([[0.0, 3.0, 4.0]])).tolist()
        [5.0]
    """
    moved = se3.apply(T_true, np.asarray(source, dtype=np.float64))
    distances: F64 = np.linalg.norm(moved - np.asarray(target, dtype=np.float64), axis=1)
    return distances


def inlier_ratio(
    T_true: F64, source: Points, target: Points, threshold_m: float = INLIER_THRESHOLD_M
) -> float:
    """IR: share of correspondences (K, 3), (K, 3) closer than the threshold; 0 for none.

    Examples:
        >>> inlier_ratio(np.eye(4), np.zeros((2, 3)), np.array([[0.05, 0, 0], [1.0, 0, 0]]))
        0.5
    """
    if len(source) == 0:
        return 0.0
    return float(np.mean(residuals_m(T_true, source, target) < threshold_m))


def feature_matching_recall(
    inlier_ratios: NDArray[np.floating], threshold: float = FMR_THRESHOLD
) -> float:
    """FMR: share of pairs whose inlier ratio is above the threshold; NaN for no pairs.

    Examples:
        >>> feature_matching_recall(np.array([0.2, 0.04]))
        0.5
    """
    values = np.asarray(inlier_ratios, dtype=np.float64)
    return float(np.mean(values > threshold)) if len(values) else float('nan')


def coarse_precision(
    overlap: NDArray[np.floating],
    source_index: NDArray[np.integer],
    target_index: NDArray[np.integer],
    threshold: float = 0.0,
) -> float:
    """PIR: share of selected superpoint pairs whose patches truly overlap; 0 for none selected.

    Args:
        overlap: (N, M) true overlap of source patch i and target patch j, [0, 1].
        source_index: (K,) selected source superpoints.
        target_index: (K,) selected target superpoints.
        threshold: overlap above which a pair is right.

    Examples:
        >>> coarse_precision(np.array([[0.4, 0.0]]), np.array([0, 0]), np.array([0, 1]))
        0.5
    """
    if len(source_index) == 0:
        return 0.0
    return float(np.mean(overlap[source_index, target_index] > threshold))


def roc_auc(positive: NDArray[np.bool_], score: NDArray[np.floating]) -> float:
    """Area under the ROC curve: P(score of a positive > score of a negative), ties count half.

    Args:
        positive: (N,) truth.
        score: (N,) higher = more likely positive.

    Returns:
        The area; NaN when one class is missing.

    Examples:
        >>> roc_auc(np.array([True, False]), np.array([0.9, 0.1]))
        1.0
    """
    truth = np.asarray(positive, dtype=bool)
    n_pos = int(truth.sum())
    n_neg = len(truth) - n_pos
    if n_pos == 0 or n_neg == 0:
        return float('nan')
    _, inverse, counts = np.unique(
        np.asarray(score, dtype=np.float64), return_inverse=True, return_counts=True
    )
    last = np.cumsum(counts)
    mean_rank = last - 0.5 * (counts - 1)
    rank_sum = float(mean_rank[inverse][truth].sum())
    return (rank_sum - n_pos * (n_pos + 1) / 2.0) / (n_pos * n_neg)


def bootstrap_interval(
    values: NDArray[np.floating], *, samples: int = 2000, level: float = 0.95, seed: int = 0
) -> tuple[float, float]:
    """Percentile bootstrap interval of a mean.

    Args:
        values: (P,) one value per pair, for example success of A minus success of B.
        samples: number of resamples.
        level: share of the distribution inside.
        seed: of the resampling.

    Returns:
        (low, high); NaN for no values.

    Examples:
        >>> bootstrap_interval(np.ones(5))
        (1.0, 1.0)
    """
    v = np.asarray(values, dtype=np.float64)
    if len(v) == 0:
        return float('nan'), float('nan')
    rng = np.random.default_rng(seed)
    means = v[rng.integers(0, len(v), (samples, len(v)))].mean(axis=1)
    tail = 50.0 * (1.0 - level)
    low, high = np.percentile(means, [tail, 100.0 - tail])
    return float(low), float(high)


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a share, by Wilson; honest also near 0 and 1.

    Returns:
        (low, high); NaN for no trials.

    Examples:
        >>> [round(v, 3) for v in wilson_interval(50, 100)]
        [0.404, 0.596]
    """
    if trials == 0:
        return float('nan'), float('nan')
    z, share = 1.959964, successes / trials
    scale = 1.0 + z * z / trials
    middle = (share + z * z / (2.0 * trials)) / scale
    half = z * float(np.sqrt(share * (1.0 - share) / trials + z * z / (4.0 * trials**2))) / scale
    return max(middle - half, 0.0), min(middle + half, 1.0)
