# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Trajectory scores: ATE and RPE through evo, KITTI segment drift, error of single steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import FileFormatError, require
from hybridreg_ros.core.scan import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

KITTI_LENGTHS_M = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
SHORT_SHARES = (0.1, 0.2, 0.3, 0.4, 0.5)
SEGMENT_START_STEP = 10
DEFAULT_TOLERANCE_S = 0.01


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses over time, ordered by stamp.

    Attributes:
        stamps: (N,) int64, nanoseconds, strictly increasing.
        poses: (N, 4, 4) float64, T_world_sensor, metres.
    """

    stamps: NDArray[np.int64]
    poses: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Check shapes, order and finiteness.

        Raises:
            FileFormatError: arrays do not fit each other, stamps do not increase, or a pose is not
                a rigid transform.
        """
        stamps = np.ascontiguousarray(self.stamps, dtype=np.int64)
        poses = np.ascontiguousarray(self.poses, dtype=np.float64)
        if poses.shape != (len(stamps), 4, 4):
            raise FileFormatError(
                f'a trajectory of {len(stamps)} stamps needs ({len(stamps)}, 4, 4) poses, '
                f'found {poses.shape}'
            )
        if len(stamps) > 1 and (np.diff(stamps) <= 0).any():
            row = int(np.argmax(np.diff(stamps) <= 0)) + 1
            raise FileFormatError(f'stamps must increase, row {row} does not')
        bad = [i for i, T in enumerate(poses) if not se3.is_rigid(T, 1e-3)]
        if bad:
            raise FileFormatError(f'pose of row {bad[0]} is not a rigid transform')
        object.__setattr__(self, 'stamps', stamps)
        object.__setattr__(self, 'poses', poses)

    def __len__(self) -> int:
        """Number of poses N."""
        return len(self.stamps)

    def take(self, index: NDArray[np.int64]) -> Trajectory:
        """Trajectory of the chosen rows."""
        return Trajectory(self.stamps[index], self.poses[index])

    @property
    def path_m(self) -> float:
        """Length of the path, metres."""
        return float(path_lengths(self.poses)[-1]) if len(self) else 0.0


@dataclass(frozen=True)
class DriftScore:
    """KITTI drift: relative error over all segments of given lengths.

    Attributes:
        translation_percent: mean translation error in percent of the segment length.
        rotation_deg_per_100m: mean rotation error, degrees per 100 m.
        segments: number of segments.
        lengths_m: the lengths used; KITTI's 100 to 800 m, or shares of a path below 100 m.
    """

    translation_percent: float
    rotation_deg_per_100m: float
    segments: int
    lengths_m: tuple[float, ...]


@dataclass(frozen=True)
class TrajectoryScore:
    """Everything said about one trajectory against its reference.

    Attributes:
        matched: poses of the estimate that have a reference pose at their stamp.
        unmatched: poses of the estimate that have none.
        reference_unmatched: reference poses inside the estimate's time that it does not cover.
        path_m: length of the reference path over the matched poses.
        ate_rmse_m: RMSE of positions after SE(3) alignment.
        ate_max_m: largest such error.
        ate_percent: ATE in percent of the path.
        rpe_rmse_m: RMSE of the translation of consecutive relative poses.
        rpe_rmse_deg: RMSE of their rotation.
        step_mean_mm: mean translation error of consecutive steps.
        step_median_mm: median of the same.
        step_max_mm: largest.
        step_mean_deg: mean rotation error of consecutive steps.
        drift: KITTI drift, None when the path is too short for one segment.
    """

    matched: int
    unmatched: int
    reference_unmatched: int
    path_m: float
    ate_rmse_m: float
    ate_max_m: float
    ate_percent: float
    rpe_rmse_m: float
    rpe_rmse_deg: float
    step_mean_mm: float
    step_median_mm: float
    step_max_mm: float
    step_mean_deg: float
    drift: DriftScore | None


def path_lengths(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance travelled up to each pose (N,), metres.

    Examples:
        >>> poses = np.tile(np.eye(4), (3, 1, 1)); poses[:, 0, 3] = [0.0, 1.0, 3.0]
        >>> path_lengths(poses).tolist()
        [0.0, 1.0, 3.0]
    """
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return np.concatenate([np.zeros(min(1, len(poses))), np.cumsum(steps)])


def associate(
    estimate: Trajectory, reference: Trajectory, tolerance_s: float = DEFAULT_TOLERANCE_S
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pair poses whose stamps are nearest to each other and within a tolerance.

    Args:
        estimate: trajectory to score.
        reference: the truth.
        tolerance_s: largest difference of stamps, seconds.

    Returns:
        Rows of `estimate` and rows of `reference`, both (K,) and increasing.

    Raises:
        FileFormatError: a trajectory is empty, or no pair of stamps agrees.
    """
    for name, trajectory in (('estimate', estimate), ('reference', reference)):
        if len(trajectory) == 0:
            raise FileFormatError(f'the {name} holds no pose')
    right = np.searchsorted(reference.stamps, estimate.stamps).clip(0, len(reference) - 1)
    left = (right - 1).clip(0)
    gap_right = np.abs(reference.stamps[right] - estimate.stamps)
    gap_left = np.abs(reference.stamps[left] - estimate.stamps)
    nearest = np.where(gap_left <= gap_right, left, right)
    gap = np.minimum(gap_left, gap_right)
    best: dict[int, int] = {}
    for row in np.flatnonzero(gap <= round(tolerance_s * NS_PER_S)).tolist():
        other = int(nearest[row])
        if other not in best or gap[row] < gap[best[other]]:
            best[other] = row
    if not best:
        raise FileFormatError(
            f'no stamps in common within {tolerance_s:g} s: the estimate covers '
            f'{_span(estimate)}, the reference {_span(reference)}'
        )
    pairs = sorted((row, other) for other, row in best.items())
    rows, others = np.array(pairs, dtype=np.int64).T
    return rows, others


def _span(trajectory: Trajectory) -> str:
    first, last = trajectory.stamps[0] / NS_PER_S, trajectory.stamps[-1] / NS_PER_S
    return f'{first:.3f} to {last:.3f} s'


def step_errors(
    estimate: NDArray[np.float64], reference: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Error of each step from one pose to the next.

    Args:
        estimate: (N, 4, 4), N >= 1.
        reference: (N, 4, 4), matched row by row.

    Returns:
        Translation (N - 1,) in metres and rotation (N - 1,) in degrees of
        inverse(reference step) * (estimated step).

    Examples:
        >>> still = np.tile(np.eye(4), (2, 1, 1)); moved = still.copy(); moved[1, 0, 3] = 0.5
        >>> [e.tolist() for e in step_errors(moved, still)]
        [[0.5], [0.0]]
    """
    metres, degrees = [], []
    for i in range(len(estimate) - 1):
        step = se3.inverse(estimate[i]) @ estimate[i + 1]
        true_step = se3.inverse(reference[i]) @ reference[i + 1]
        error = se3.inverse(true_step) @ step
        metres.append(float(np.linalg.norm(error[:3, 3])))
        degrees.append(se3.rotation_angle_deg(error[:3, :3]))
    return np.array(metres), np.array(degrees)


def segment_drift(
    estimate: NDArray[np.float64],
    reference: NDArray[np.float64],
    lengths_m: tuple[float, ...] | None = None,
) -> DriftScore | None:
    """Drift as the KITTI odometry benchmark defines it.

    Segments start at every tenth pose and end at the first pose farther along the reference path
    than their length. A path below 100 m uses shares of itself as lengths instead.

    Args:
        estimate: (N, 4, 4).
        reference: (N, 4, 4), matched row by row.
        lengths_m: segment lengths; None chooses them from the path.

    Returns:
        None when no segment fits.
    """
    along = path_lengths(reference)
    path = float(along[-1]) if len(along) else 0.0
    if lengths_m is None:
        lengths_m = (
            KITTI_LENGTHS_M
            if path > KITTI_LENGTHS_M[0]
            else tuple(round(share * path, 6) for share in SHORT_SHARES)
        )
    start_step = SEGMENT_START_STEP if path > KITTI_LENGTHS_M[0] else 1
    translation, rotation = [], []
    for first in range(0, len(along), start_step):
        for length in lengths_m:
            last = int(np.searchsorted(along, along[first] + length, side='right'))
            if length <= 0.0 or last >= len(along):
                continue
            moved = se3.inverse(estimate[first]) @ estimate[last]
            truth = se3.inverse(reference[first]) @ reference[last]
            error = se3.inverse(moved) @ truth
            translation.append(np.linalg.norm(error[:3, 3]) / length)
            rotation.append(se3.rotation_angle_deg(error[:3, :3]) / length)
    if not translation:
        return None
    return DriftScore(
        translation_percent=100.0 * float(np.mean(translation)),
        rotation_deg_per_100m=100.0 * float(np.mean(rotation)),
        segments=len(translation),
        lengths_m=lengths_m,
    )


def aligned(estimate: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses of the estimate (N, 4, 4) after the SE(3) alignment of positions that ATE uses."""
    T: NDArray[np.float64] = se3.kabsch(estimate[:, :3, 3], reference[:, :3, 3])
    moved: NDArray[np.float64] = T @ estimate
    return moved


def score(
    estimate: Trajectory, reference: Trajectory, tolerance_s: float = DEFAULT_TOLERANCE_S
) -> TrajectoryScore:
    """Score an estimated trajectory against a reference.

    Args:
        estimate: T_odom_sensor over time; its frame may differ from the reference's by a constant.
        reference: T_world_sensor over time.
        tolerance_s: largest difference of stamps, seconds.

    Raises:
        FileFormatError: fewer than two poses have a partner.
        DependencyError: evo is not installed.
    """
    rows, others = associate(estimate, reference, tolerance_s)
    if len(rows) < 2:
        raise FileFormatError(
            f'{len(rows)} pose in common, at least 2 are needed to score a trajectory'
        )
    est, ref = estimate.poses[rows], reference.poses[others]
    ape, rpe_m, rpe_deg = _evo_errors(est, ref)
    metres, degrees = step_errors(est, ref)
    path = float(path_lengths(ref)[-1])
    inside = (reference.stamps >= estimate.stamps[0]) & (reference.stamps <= estimate.stamps[-1])
    inside[others] = False
    ate = _rms(ape)
    return TrajectoryScore(
        matched=len(rows),
        unmatched=len(estimate) - len(rows),
        reference_unmatched=int(inside.sum()),
        path_m=path,
        ate_rmse_m=ate,
        ate_max_m=float(ape.max()),
        ate_percent=100.0 * ate / path if path > 0.0 else float('nan'),
        rpe_rmse_m=_rms(rpe_m),
        rpe_rmse_deg=_rms(rpe_deg),
        step_mean_mm=1000.0 * float(metres.mean()),
        step_median_mm=1000.0 * float(np.median(metres)),
        step_max_mm=1000.0 * float(metres.max()),
        step_mean_deg=float(degrees.mean()),
        drift=segment_drift(est, ref),
    )


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _evo_errors(
    estimate: NDArray[np.float64], reference: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """APE of positions (m, aligned), RPE translation (m) and RPE rotation (deg) from evo."""
    require('scoring a trajectory', 'replay', 'evo')
    from evo.core import metrics
    from evo.core.trajectory import PosePath3D

    ref = PosePath3D(poses_se3=list(reference))
    errors = []
    for metric, poses in (
        (metrics.APE(metrics.PoseRelation.translation_part), aligned(estimate, reference)),
        (metrics.RPE(metrics.PoseRelation.translation_part, 1, metrics.Unit.frames), estimate),
        (metrics.RPE(metrics.PoseRelation.rotation_angle_deg, 1, metrics.Unit.frames), estimate),
    ):
        metric.process_data((ref, PosePath3D(poses_se3=list(poses))))
        errors.append(np.asarray(metric.error, dtype=np.float64))
    return errors[0], errors[1], errors[2]
