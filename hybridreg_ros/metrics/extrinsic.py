# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A reference of another body than the estimate: the pose between both, given or fitted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import ConfigError, HybridRegError
from hybridreg_ros.core.quaternion import from_quaternion, to_quaternion
from hybridreg_ros.metrics.trajectory import (
    Trajectory,
    associate,
    path_lengths,
    segment_drift,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

_FEWEST = 10
_SPANS = (0.05, 0.15, 0.4)
"""Lengths of the relative motions compared, as shares of the poses."""
_MOST_PAIRS = 600
_NOTABLE = 0.02
"""A median error of the motions below this share of their length needs no explanation."""
_EXPLAINED = 0.3
"""Share of the errors that may be left for a fitted pose to count as their cause."""
_STIFF = 1e-3
"""Weight that keeps at zero what the motions do not show."""


def extrinsic_of(numbers: Sequence[float]) -> F64:
    """Transform (4, 4) of seven numbers x y z (m) qx qy qz qw.

    Raises:
        ConfigError: the quaternion has not norm 1, or a number is not finite.
    """
    try:
        R = from_quaternion(*numbers[3:])
    except HybridRegError as error:
        raise ConfigError(f'extrinsic: {error}') from None
    if not np.isfinite(numbers).all():
        raise ConfigError('extrinsic: expected finite numbers')
    return se3.transform(R, np.array(numbers[:3]))


def follow(reference: Trajectory, T_reference_estimate: F64) -> Trajectory:
    """The trajectory of a body fixed to that of a reference.

    Args:
        reference: T_world_reference over time.
        T_reference_estimate: (4, 4) pose of the other body in the reference's, metres.
    """
    return Trajectory(reference.stamps, reference.poses @ T_reference_estimate)


def fit_extrinsic(estimate: F64, reference: F64) -> F64 | None:
    """Pose of the estimated body in the reference's that explains most of their difference.

    Relative motions E of the estimate and R of the reference obey E = inverse(X) R X for bodies
    that are fixed to each other by X (the hand-eye equation of Tsai and Lenz, 1989). X is found by
    least squares over motions of several lengths; what they do not show stays zero.

    Args:
        estimate: (N, 4, 4), matched row by row.
        reference: (N, 4, 4).

    Returns:
        X (4, 4); None where the difference is small, or X does not explain most of it.
    """
    from scipy.optimize import least_squares

    pairs = _pairs(len(reference))
    if len(reference) < _FEWEST or float(path_lengths(reference)[-1]) <= 0.0:
        return None
    E = np.array([se3.inverse(estimate[i]) @ estimate[j] for i, j in pairs])
    R = np.array([se3.inverse(reference[i]) @ reference[j] for i, j in pairs])
    before = np.linalg.norm(_differences(E, R, np.zeros(6)), axis=1)
    lengths = np.linalg.norm(R[:, :3, 3], axis=1)
    scale = float(lengths.mean())
    if float(np.median(before / np.maximum(lengths, 1e-3 * scale))) < _NOTABLE:
        return None
    start = np.concatenate([np.zeros(3), se3.so3_log(_turn(E, R, scale))])
    fit = least_squares(
        lambda x: np.append(_differences(E, R, x), _STIFF * x[:3]) / scale,
        start,
        loss='soft_l1',
        f_scale=0.05,
        max_nfev=100,
    )
    after = np.linalg.norm(_differences(E, R, fit.x), axis=1)
    explains = float(np.median(after)) < _EXPLAINED * float(np.median(before))
    return _transform(fit.x) if explains else None


def other_body(estimate: Trajectory, reference: Trajectory, tolerance_s: float) -> str:
    """One line that names the pose between the bodies of both, '' where none is found.

    Args:
        estimate: scored.
        reference: the truth.
        tolerance_s: largest difference of stamps, seconds.

    Raises:
        FileFormatError: no pair of stamps agrees.
    """
    rows, others = associate(estimate, reference, tolerance_s)
    est, ref = estimate.poses[rows], reference.poses[others]
    X = fit_extrinsic(est, ref)
    if X is None:
        return ''
    pose = ' '.join(f'{round(v, 4) + 0.0:g}' for v in (*X[:3, 3], *to_quaternion(X[:3, :3])))
    before, after = segment_drift(est, ref), segment_drift(est, ref @ X)
    change = ''
    if before is not None and after is not None:
        change = (
            f': the drift is {after.translation_percent:.3g} instead of '
            f'{before.translation_percent:.3g} % then'
        )
    return f'the truth seems to be that of another body, try --extrinsic {pose}{change}'


def _pairs(count: int) -> list[tuple[int, int]]:
    """First and last pose of the motions that are compared."""
    found = []
    for share in _SPANS:
        step = max(1, round(share * count))
        every = max(1, (count - step) * len(_SPANS) // _MOST_PAIRS)
        found += [(i, i + step) for i in range(0, count - step, every)]
    return found


def _transform(x: F64) -> F64:
    return se3.transform(se3.so3_exp(x[3:]), x[:3])


def _differences(E: F64, R: F64, x: F64) -> F64:
    """Translations (K, 3) of E less those of inverse(X) R X, metres."""
    X = _transform(x)
    moved = se3.inverse(X) @ R @ X
    difference: F64 = E[:, :3, 3] - moved[:, :3, 3]
    return difference


def _turn(E: F64, R: F64, length: float) -> F64:
    """Rotation (3, 3) of X when its translation is neglected: axes and ways turn alike."""
    axes = [np.array([se3.so3_log(T[:3, :3]) for T in motions]) * length for motions in (E, R)]
    ways = [E[:, :3, 3], R[:, :3, 3]]
    both = [np.concatenate([axes[k], ways[k]]) for k in (0, 1)]
    H = both[0].T @ both[1]
    turn: F64 = se3.from_moments(H, np.zeros(3), np.zeros(3))[:3, :3]
    return turn
