# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Errors of the single frames of a run against the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.metrics.trajectory import aligned, associate, step_errors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.metrics.trajectory import Trajectory
    from hybridreg_ros.replay.runner import ReplayLog


@dataclass(frozen=True, eq=False)
class FrameErrors:
    """Errors of one run's frames against the truth.

    Attributes:
        rows: (N,) rows of `log.frames`.
        position_mm: (N,) distance to the true position after alignment of the whole path.
        step_mm: (N,) translation error of the step to this frame, NaN for the first.
        path: (N, 3) aligned positions, metres.
        truth_path: (N, 3) true positions, metres.
        T_odom_world: (4, 4) the alignment, the other way round.
    """

    rows: NDArray[np.int64]
    position_mm: NDArray[np.float64]
    step_mm: NDArray[np.float64]
    path: NDArray[np.float64]
    truth_path: NDArray[np.float64]
    T_odom_world: NDArray[np.float64]


def frame_errors(log: ReplayLog, truth: Trajectory) -> FrameErrors:
    """Errors of every frame that has a true pose.

    Raises:
        FileFormatError: no stamps in common.
    """
    estimate = log.trajectory()
    mine, others = associate(estimate, truth)
    est, ref = estimate.poses[mine], truth.poses[others]
    moved = aligned(est, ref)
    row_of = {f.stamp: k for k, f in enumerate(log.frames) if f.accepted}
    return FrameErrors(
        rows=np.array([row_of[s] for s in estimate.stamps[mine].tolist()], np.int64),
        position_mm=1000.0 * np.linalg.norm(moved[:, :3, 3] - ref[:, :3, 3], axis=1),
        step_mm=np.concatenate([[np.nan], 1000.0 * step_errors(est, ref)[0]]),
        path=moved[:, :3, 3],
        truth_path=ref[:, :3, 3],
        T_odom_world=est[0] @ se3.inverse(moved[0]),
    )
