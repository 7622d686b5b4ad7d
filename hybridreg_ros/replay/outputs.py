# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Files of a replay: odometry.tum, dynamic.mcap and metrics.json, readable even when cut short."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from hybridreg_ros.core import provenance
from hybridreg_ros.core.pointcloud2 import with_field
from hybridreg_ros.metrics import mask, trajectory
from hybridreg_ros.metrics.extrinsic import other_body
from hybridreg_ros.odometry.warm_up import SCANS
from hybridreg_ros.replay.bag_reader import GROUND_TRUTH_TOPIC
from hybridreg_ros.replay.bag_writer import TF, TF_STATIC, BagWriter
from hybridreg_ros.replay.recording import WORLD_FRAME
from hybridreg_ros.replay.runner import DYNAMIC_THRESHOLD
from hybridreg_ros.replay.trajectory_io import tum_row

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.metrics.trajectory import Trajectory
    from hybridreg_ros.odometry.result import OdometryResult
    from hybridreg_ros.replay.frame_errors import FrameErrors
    from hybridreg_ros.replay.runner import FrameLog, ReplayLog

ODOM_TOPIC = '/hybridreg/odom'
DYNAMIC_TOPIC = '/hybridreg/dynamic_points'
STATIC_TOPIC = '/hybridreg/static_points'
PROBABILITY_FIELD = 'dynamic_probability'
PATH_TOPIC = '/hybridreg/path'
TRUE_PATH_TOPIC = '/ground_truth/path'
ODOM_FRAME, UPRIGHT_FRAME = 'odom', 'upright'
UPRIGHT = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64)
"""(4, 4) from the axes of a camera (x right, y down, z ahead) to x ahead, y left, z up."""


class Ending(Protocol):
    """What takes the paths when a run is over."""

    def end(
        self,
        made: Trajectory,
        optical: bool,
        truth: Trajectory | None = None,
        T_odom_world: NDArray[np.float64] | None = None,
    ) -> None:
        """Take T_odom_sensor, T_world_sensor and the alignment of both; see OutputFiles."""


class OutputFiles:
    """odometry.tum, complete after every line; dynamic.mcap, and foxglove.json that shows it.

    The bag holds what the node publishes of each scan, /tf, the paths and the truth.
    """

    def __init__(
        self, folder: Path, clouds: bool = True, threshold: float = DYNAMIC_THRESHOLD
    ) -> None:
        self._bag = BagWriter(folder / 'dynamic.mcap', overwrite=True)
        self._tum = (folder / 'odometry.tum').open('w', encoding='ascii', buffering=1)
        shutil.copyfile(Path(__file__).with_name('foxglove.json'), folder / 'foxglove.json')
        self._threshold = threshold
        self._clouds = clouds
        self._sensor = ''
        self.write_cloud = self._bag.write_cloud

    def add(self, message: Any, result: OdometryResult) -> None:
        """Write the messages of one scan; clouds keep every field of the input message."""
        scan = result.scan
        self.write_odometry(
            result.stamp,
            (ODOM_FRAME, scan.frame_id),
            result.pose,
            result.covariance,
            result.twist,
            result.twist_covariance,
        )
        if not self._clouds:
            return
        probability = np.asarray(result.dynamic_probability, dtype=np.float32)
        moving = probability >= self._threshold
        for topic, keep in ((DYNAMIC_TOPIC, moving), (STATIC_TOPIC, ~moving)):
            cloud = with_field(message, scan, PROBABILITY_FIELD, probability, keep)
            self.write_cloud(topic, result.stamp, scan.frame_id, cloud)

    def write_odometry(
        self, stamp: int, frames: tuple[str, str], pose: NDArray[np.float64], *rest: Any
    ) -> None:
        """Write a pose to all of them; `rest` as of `BagWriter.write_odometry`."""
        self._sensor = frames[1]
        self._tum.write(tum_row(stamp, pose) + '\n')
        self._bag.write_odometry(ODOM_TOPIC, stamp, frames, pose, *rest)
        self._bag.write_transform(TF, stamp, frames, pose)

    def end(
        self,
        made: Trajectory,
        optical: bool,
        truth: Trajectory | None = None,
        T_odom_world: NDArray[np.float64] | None = None,
    ) -> None:
        """Write paths and truth; with the first stamp, so that viewers show them from the start.

        Args:
            made: T_odom_sensor.
            optical: whether odom has the axes of a camera; the frame `upright` has z up.
            truth: T_world_sensor.
            T_odom_world: (4, 4) alignment of the truth.
        """
        if len(made):
            start, turn = int(made.stamps[0]), UPRIGHT if optical else np.eye(4)
            self._bag.write_transform(TF_STATIC, start, (UPRIGHT_FRAME, ODOM_FRAME), turn)
            self._bag.write_path(PATH_TOPIC, ODOM_FRAME, made)
        if truth is not None and T_odom_world is not None:
            self._bag.write_transform(TF_STATIC, start, (ODOM_FRAME, WORLD_FRAME), T_odom_world)
            seen = (truth.stamps >= start) & (truth.stamps <= made.stamps[-1])
            part = trajectory.Trajectory(truth.stamps[seen], truth.poses[seen])
            self._bag.write_path(TRUE_PATH_TOPIC, WORLD_FRAME, part)
            frames = (WORLD_FRAME, self._sensor)
            for stamp, pose in zip(part.stamps.tolist(), part.poses, strict=True):
                self._bag.write_odometry(GROUND_TRUTH_TOPIC, stamp, frames, pose)
        self.close()

    def close(self) -> None:
        """Finish the files; closing twice does nothing."""
        self._tum.close()
        self._bag.close()


@dataclasses.dataclass(frozen=True, eq=False)
class Scores:
    """Scores of a run.

    Attributes:
        trajectory: None without truth.
        mask: None without labels.
        note: why something could not be scored, '' when all was.
        warning: what makes the scores doubtful, '' for nothing.
    """

    trajectory: trajectory.TrajectoryScore | None = None
    mask: mask.MaskScore | None = None
    note: str = ''
    warning: str = ''


def score_log(log: ReplayLog, truth: Trajectory | None) -> Scores:
    """Score a run, live or offline, against the truth of its bag.

    Args:
        log: the run.
        truth: T_world_sensor, or None.
    """
    counts = log.mask_counts()
    mask_score = None if counts is None else mask.score(counts)
    if truth is None:
        return Scores(None, mask_score, 'the bag holds no ground truth')
    estimate = log.trajectory()
    if len(estimate) < 2:
        return Scores(None, mask_score, f'{len(estimate)} poses are too few to score')
    warning = other_body(estimate, truth, trajectory.DEFAULT_TOLERANCE_S)
    return Scores(trajectory.score(estimate, truth), mask_score, '', warning)


def stage_times(frames: Sequence[FrameLog]) -> dict[str, dict[str, float]]:
    """Median, mean and 95th percentile of each stage, milliseconds; all together comes last.

    The first scans, which load code and compile it, are left out where there are others.
    """
    frames = frames[SCANS - 1 :] or frames
    stages = sorted({s: 0 for f in frames for s in f.seconds}, key=lambda s: s == 'total')
    table = {}
    for stage in stages:
        ms = 1000.0 * np.array([f.seconds[stage] for f in frames if stage in f.seconds])
        table[stage] = {
            'median': float(np.median(ms)),
            'mean': float(ms.mean()),
            'p95': float(np.percentile(ms, 95)),
        }
    return table


def metrics_of(
    log: ReplayLog,
    scores: Scores,
    config: Mapping[str, Any],
    bag: Path,
    errors: FrameErrors | None = None,
    **about: Any,
) -> dict[str, Any]:
    """Content of metrics.json.

    Args:
        log: the run.
        scores: its scores.
        config: configuration of the front end, plain values.
        bag: input, whose checksum is recorded.
        errors: of the single frames, None without truth.
        **about: further entries such as topic, stride, registrar, live, recovered.
    """
    frames = log.frames
    rows = [_frame_row(f) for f in frames]
    if errors is not None:
        for k, row in enumerate(errors.rows.tolist()):
            rows[row] |= {'position_mm': errors.position_mm[k], 'step_mm': errors.step_mm[k]}
    seen = {f.reason for f in frames}
    confidence = np.array([f.confidence for f in frames if math.isfinite(f.confidence)])
    return {
        'bag': str(bag),
        **about,
        'frames': len(frames),
        'accepted': sum(f.accepted for f in frames),
        'drops': log.drops,
        'interrupted': log.interrupted,
        'notes': log.notes,
        'point_times': dict(log.times_from),
        'sources': log.sources(),
        'reasons': {r: sum(f.reason == r for f in frames) for r in sorted(seen)},
        'confidence_mean': float(confidence.mean()) if len(confidence) else None,
        'dynamic_share': sum(f.dynamic for f in frames) / max(sum(f.points for f in frames), 1),
        'trajectory': scores.trajectory,
        'mask': scores.mask,
        'not_scored': scores.note,
        'warning': scores.warning,
        'time_ms': stage_times(frames),
        'wall_s': log.wall_s,
        'per_frame': rows,
        'provenance': provenance.collect(config, (bag,)),
    }


def _frame_row(frame: FrameLog) -> dict[str, Any]:
    """Per-frame entry of metrics.json (the pose stands in odometry.tum)."""
    return {
        'stamp': frame.stamp,
        'source': frame.source,
        'reason': frame.reason,
        'confidence': frame.confidence,
        'points': frame.points,
        'invalid': frame.invalid,
        'near': frame.near,
        'dynamic': frame.dynamic,
        'accepted': frame.accepted,
        'total_ms': 1000.0 * frame.seconds.get('total', float('nan')),
        'mask': frame.mask,
    }


def write_trajectories(folder: Path, made: Trajectory, truth: Trajectory | None) -> None:
    """Write odometry_kitti.txt, and truth.tum and truth_kitti.txt where there is a truth.

    The rows of both KITTI files belong together: poses that lack a partner are left out of both.
    """
    rows, others = np.arange(len(made)), None
    if truth is not None and len(made) and len(truth):
        (folder / 'truth.tum').write_text(
            ''.join(tum_row(s, T) + '\n' for s, T in zip(truth.stamps, truth.poses, strict=True)),
            encoding='ascii',
        )
        rows, others = trajectory.associate(made, truth)
        _write_kitti(folder / 'truth_kitti.txt', truth.poses[others])
    _write_kitti(folder / 'odometry_kitti.txt', made.poses[rows])


def _write_kitti(path: Path, poses: NDArray[np.float64]) -> None:
    np.savetxt(path, poses[:, :3].reshape(-1, 12), fmt='%.12g')


def plain(value: Any) -> Any:
    """Nested plain values for JSON: dataclasses become mappings, NaN and inf become null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def write_json(path: Path, value: Any) -> None:
    """Write plain JSON; the file appears complete or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_name(f'.{path.name}.writing')
    scratch.write_text(json.dumps(plain(value), indent=1, allow_nan=False) + '\n', 'utf-8')
    scratch.replace(path)
