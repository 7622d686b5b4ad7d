# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Trajectory scores against evo, scipy and the KITTI definition written out a second time."""

from __future__ import annotations

import dataclasses
import doctest
import itertools
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.metrics import trajectory as tr

if TYPE_CHECKING:
    from numpy.typing import NDArray

SECOND = 1_000_000_000


def walk(n: int, seed: int, step_m: float = 0.3, noise: float = 0.0) -> NDArray[np.float64]:
    """A smooth random path, optionally with independent noise on every step."""
    rng = np.random.default_rng(seed)
    wobble = np.random.default_rng(seed + 1000)
    turn = np.cumsum(rng.normal(0, 0.01, (n, 3)), axis=0)
    poses = [np.eye(4)]
    for i in range(n - 1):
        xi = np.concatenate([[step_m, 0.0, 0.0], turn[i]])
        poses.append(poses[-1] @ se3.exp(xi + wobble.normal(0, 1, 6) * noise))
    return np.array(poses)


def make(poses: NDArray[np.float64], start_s: float = 1_600_000_000.0) -> tr.Trajectory:
    stamps = round(start_s * SECOND) + np.arange(len(poses)) * SECOND // 10
    return tr.Trajectory(stamps, poses)


def test_doctests() -> None:
    assert doctest.testmod(tr, globs={'np': np, **vars(tr)}).failed == 0


def test_perfect_estimate_in_another_frame_scores_zero() -> None:
    truth = walk(60, 1)
    T = se3.exp(np.array([3.0, -2.0, 1.0, 0.3, -0.8, 2.0]))
    score = tr.score(make(T @ truth), make(truth))
    assert score.matched == 60
    assert score.ate_rmse_m < 1e-9
    assert score.step_max_mm < 1e-9
    assert score.rpe_rmse_deg < 1e-5  # acos of a number next to 1
    assert score.drift is not None
    assert score.drift.translation_percent < 1e-9


def test_ate_equals_evo_umeyama_and_rpe_equals_scipy() -> None:
    from evo.core import metrics
    from evo.core.trajectory import PoseTrajectory3D

    truth, estimate = make(walk(80, 2)), make(walk(80, 2, noise=0.01))
    score = tr.score(estimate, truth)
    pair = [
        PoseTrajectory3D(poses_se3=list(t.poses), timestamps=t.stamps / SECOND)
        for t in (truth, estimate)
    ]
    pair[1].align(pair[0], correct_scale=False)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data(tuple(pair))
    assert score.ate_rmse_m == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse))
    assert score.ate_max_m == pytest.approx(ape.get_statistic(metrics.StatisticsType.max))
    assert score.ate_percent == pytest.approx(100 * score.ate_rmse_m / truth.path_m)
    metres, degrees = [], []
    for a, b, c, d in zip(
        truth.poses, truth.poses[1:], estimate.poses, estimate.poses[1:], strict=False
    ):
        error = np.linalg.inv(np.linalg.inv(a) @ b) @ (np.linalg.inv(c) @ d)
        metres.append(np.linalg.norm(error[:3, 3]))
        degrees.append(np.rad2deg(Rotation.from_matrix(error[:3, :3]).magnitude()))
    assert score.step_mean_mm == pytest.approx(1000 * np.mean(metres))
    assert score.step_mean_deg == pytest.approx(np.mean(degrees))
    assert score.rpe_rmse_m == pytest.approx(np.sqrt(np.mean(np.square(metres))))
    assert score.rpe_rmse_deg == pytest.approx(np.sqrt(np.mean(np.square(degrees))), rel=1e-4)


def test_kitti_drift_against_plain_loops() -> None:
    truth = walk(700, 5, step_m=1.0)
    estimate = walk(700, 5, step_m=1.0, noise=0.002)
    travelled = [0.0]
    for a, b in itertools.pairwise(truth):
        travelled.append(travelled[-1] + float(np.linalg.norm(b[:3, 3] - a[:3, 3])))
    t_errors, r_errors = [], []
    for first in range(0, 700, 10):
        for length in range(100, 801, 100):
            last = next(
                (k for k in range(first, 700) if travelled[k] > travelled[first] + length), None
            )
            if last is None:
                continue
            true_move = np.linalg.inv(truth[first]) @ truth[last]
            move = np.linalg.inv(estimate[first]) @ estimate[last]
            error = np.linalg.inv(move) @ true_move
            t_errors.append(np.linalg.norm(error[:3, 3]) / length)
            r_errors.append(Rotation.from_matrix(error[:3, :3]).magnitude() / length)
    drift = tr.segment_drift(estimate, truth)
    assert drift is not None
    assert drift.segments == len(t_errors)
    assert drift.lengths_m == tr.KITTI_LENGTHS_M
    assert drift.translation_percent == pytest.approx(100 * np.mean(t_errors))
    assert drift.rotation_deg_per_100m == pytest.approx(100 * np.rad2deg(np.mean(r_errors)))


def test_scale_error_shows_as_drift_in_percent() -> None:
    truth = np.tile(np.eye(4), (400, 1, 1))
    truth[:, 0, 3] = 0.05 * np.arange(400)
    estimate = truth.copy()
    estimate[:, :3, 3] *= 1.02
    drift = tr.segment_drift(estimate, truth)
    assert drift is not None
    assert drift.lengths_m[0] < 100.0
    assert drift.translation_percent == pytest.approx(2.0, rel=0.03)
    assert drift.rotation_deg_per_100m == pytest.approx(0.0, abs=1e-6)


def test_standing_still_has_no_drift_and_no_percent() -> None:
    still = make(np.tile(np.eye(4), (5, 1, 1)))
    score = tr.score(still, still)
    assert score.drift is None
    assert math.isnan(score.ate_percent)
    assert score.step_mean_mm == 0.0


def test_association_takes_the_nearest_stamp_once() -> None:
    reference = make(walk(30, 6), 100.0)
    late = np.delete(np.arange(30), [4, 5, 17])
    shifted = dataclasses.replace(
        reference.take(late), stamps=reference.stamps[late] + round(0.004 * SECOND)
    )
    rows, others = tr.associate(shifted, reference)
    assert others.tolist() == late.tolist()
    assert rows.tolist() == list(range(27))
    score = tr.score(shifted, reference)
    assert (score.matched, score.unmatched, score.reference_unmatched) == (27, 0, 3)
    twice = tr.Trajectory(
        np.sort(np.concatenate([reference.stamps, reference.stamps + 1_000_000])),
        np.repeat(reference.poses, 2, axis=0),
    )
    rows, others = tr.associate(twice, reference)
    assert rows.tolist() == list(range(0, 60, 2))
    assert len(set(others.tolist())) == len(others) == 30


def test_no_overlap_in_time_is_said() -> None:
    with pytest.raises(FileFormatError, match=r'no stamps in common .*100\.000 to 100\.400 s'):
        tr.associate(make(walk(5, 1), 100.0), make(walk(5, 1), 900.0))


def test_one_common_pose_is_too_few() -> None:
    reference = make(walk(5, 1), 100.0)
    with pytest.raises(FileFormatError, match='1 pose in common, at least 2'):
        tr.score(reference.take(np.array([2])), reference)


def test_empty_trajectory_is_said() -> None:
    empty = tr.Trajectory(np.zeros(0, np.int64), np.zeros((0, 4, 4)))
    assert empty.path_m == 0.0
    with pytest.raises(FileFormatError, match='the estimate holds no pose'):
        tr.associate(empty, make(walk(5, 1)))


@pytest.mark.parametrize(
    ('stamps', 'poses', 'text'),
    [
        ([1, 2], np.eye(4)[None], r'needs \(2, 4, 4\) poses'),
        ([2, 2], np.tile(np.eye(4), (2, 1, 1)), 'stamps must increase, row 1'),
        ([1], 2 * np.eye(4)[None], 'pose of row 0 is not a rigid transform'),
        ([1], np.full((1, 4, 4), np.nan), 'pose of row 0 is not a rigid transform'),
    ],
)
def test_bad_trajectories(stamps: list[int], poses: NDArray[np.float64], text: str) -> None:
    with pytest.raises(FileFormatError, match=text):
        tr.Trajectory(np.array(stamps), poses)
