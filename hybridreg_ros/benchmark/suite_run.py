# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One cell of a benchmark: a method on a sequence at a stride, as plain values for JSON."""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.benchmark.baseline import BASELINE_VOXEL_M, Alone
from hybridreg_ros.benchmark.suite_list import METHODS
from hybridreg_ros.core import se3
from hybridreg_ros.core.config import to_dict
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.core.provenance import collect, sha256, version
from hybridreg_ros.metrics.mask import count
from hybridreg_ros.metrics.trajectory import aligned, path_lengths, step_errors
from hybridreg_ros.odometry.selection import calibration

if TYPE_CHECKING:
    from collections.abc import Sequence as Many

    from numpy.typing import NDArray

    from hybridreg_ros.benchmark.suite_data import SuiteFrame
    from hybridreg_ros.benchmark.suite_list import Sequence
    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.result import OdometryResult
    from hybridreg_ros.replay.runner import FrontEnd

    F64 = NDArray[np.float64]

VERSION = 1
"""Of the layout and meaning of a cell; a cell of another version is made anew."""
_VIEW_POINTS = 6000
_INSTANTS = (0.0, 0.5, 1.0)
_BASELINE_PACKAGES = {'kiss-icp': 'kiss-icp', 'genz-icp': 'genz-icp', 'small-gicp': 'small_gicp'}


def config_of(method: str, base: OdometryConfig) -> OdometryConfig:
    """Settings of one of our methods.

    Raises:
        ConfigError: no such method.
    """
    if method == 'ours':
        return base
    if method == 'ours-no-mask':
        return replace(base, dynamics=replace(base.dynamics, enabled=False))
    if method == 'ours-no-network':
        return replace(base, registrar='kiss-icp')
    raise ConfigError(f'--methods: expected some of {", ".join(METHODS)}, found {method!r}')


def fingerprint(method: str, base: OdometryConfig, weights: Path | None) -> dict[str, Any]:
    """What decides the outcome of a method; a kept cell with another fingerprint is made anew.

    Args:
        method: one of METHODS.
        base: settings of ours.
        weights: checkpoint of the network.
    """
    if method in _BASELINE_PACKAGES:
        package = _BASELINE_PACKAGES[method]
        return {
            'package': f'{package} {version(package)}',
            'voxel_m': dict(BASELINE_VOXEL_M[method]),
        }
    text = json.dumps(to_dict(config_of(method, base)), sort_keys=True)
    found = {
        'config': hashlib.sha256(text.encode()).hexdigest()[:16],
        'code': _code_hash('odometry'),
        'calibration': sha256(calibration.PACKAGED)[:16],
    }
    if method != 'ours-no-network':
        found['weights'] = '' if weights is None else sha256(weights)[:16]
        found['model'] = _code_hash('model')
    return found


def _code_hash(package: str) -> str:
    """Checksum of the source files of a sub-package."""
    folder = Path(__file__).parents[1] / package
    digest = hashlib.sha256()
    for path in sorted(folder.rglob('*.py')):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def front_end(method: str, base: OdometryConfig, weights: Path | None) -> FrontEnd:
    """A fresh front end of a method."""
    from hybridreg_ros.replay.session import open_front_end

    if method in _BASELINE_PACKAGES:
        return Alone(method)
    return open_front_end(config_of(method, base), weights)


def run_cell(
    sequence: Sequence,
    frames: Many[SuiteFrame],
    method: str,
    stride: int,
    base: OdometryConfig,
    weights: Path | None,
) -> dict[str, Any]:
    """Run a method over every stride-th frame and score it.

    Args:
        sequence: what the frames are.
        frames: all of them.
        method: one of METHODS.
        stride: take every n-th.
        base: settings of ours.
        weights: checkpoint, None for the packaged one.
    """
    chosen = frames[::stride]
    ours = front_end(method, base, weights)
    rows, poses, views = [], [], {}
    threshold = base.dynamics.threshold
    for frame in chosen:
        wall, cpu = time.perf_counter(), time.process_time()
        result = ours.step(frame.scan)
        row = _row(frame, result, threshold)
        if method in _BASELINE_PACKAGES:
            row |= {'source': method, 'reason': '', 'confidence': None}
        row['wall_ms'] = 1e3 * (time.perf_counter() - wall)
        row['cpu_ms'] = 1e3 * (time.process_time() - cpu)
        rows.append(row)
        poses.append(result.pose)
        if (
            len(rows) - 1 in (len(chosen) // 2, len(chosen) - 1)
            and method not in _BASELINE_PACKAGES
        ):
            views[str(len(rows) - 1)] = _view(frame, result, threshold)
    truth = np.array([f.T_world_sensor for f in chosen])
    estimate = np.array(poses)
    instant = 0.0
    if method in _BASELINE_PACKAGES and chosen[0].scan.times is not None:
        truth, instant = _kindest(estimate, truth, chosen)
    return {
        'version': VERSION,
        'sequence': asdict(sequence),
        'method': method,
        'stride': stride,
        'fingerprint': fingerprint(method, base, weights),
        'instant': instant,
        'scores': _scores(estimate, truth, rows, sequence),
        'frames': rows,
        'views': views,
        'trajectory': {
            'estimate': aligned(estimate, truth)[:, :3, 3].round(4).tolist(),
            'truth': truth[:, :3, 3].round(4).tolist(),
        },
        'provenance': collect().to_dict(),
    }


def _view(frame: SuiteFrame, result: OdometryResult, threshold: float) -> list[list[float]]:
    """Some points of a frame seen from the sensor: two angles, degrees, and class.

    The class is 1 for a point called moving plus 2 for one that truly moves.
    """
    if len(frame.scan) == 0:  # the view is covered
        return []
    rows = np.arange(0, len(frame.scan), max(1, len(frame.scan) // _VIEW_POINTS))
    x, y, z = frame.scan.points[rows].astype(np.float64).T
    forward_z = float(np.median(z)) > float(np.median(np.hypot(x, y)))
    across = np.arctan2(x, z) if forward_z else -np.arctan2(y, x)
    up = np.arctan2(-y, np.hypot(x, z)) if forward_z else np.arctan2(z, np.hypot(x, y))
    kind = (result.dynamic_probability[rows] >= threshold).astype(np.int64)
    if frame.moving is not None:
        kind += 2 * frame.moving[rows]
    angles = np.rad2deg(np.stack([across, up], axis=1)).round(2)
    return [[float(a), float(b), int(k)] for (a, b), k in zip(angles, kind, strict=True)]


def _row(frame: SuiteFrame, result: OdometryResult, threshold: float) -> dict[str, Any]:
    """What is kept of one frame, without its errors."""
    called = result.dynamic_probability >= threshold
    mask = None if frame.moving is None else count(called, frame.moving)
    return {
        'source': result.source.value,
        'reason': result.reason.value,
        'confidence': float(result.confidence),
        'points': len(frame.scan),
        'sigma_m': float(np.sqrt(np.trace(result.covariance[:3, :3]))),
        'mask': None if mask is None else [mask.tp, mask.fp, mask.fn, mask.tn],
    }


def _kindest(estimate: F64, truth: F64, frames: Many[SuiteFrame]) -> tuple[F64, float]:
    """True poses at the instant of the scan, in [0, 1], that suits a baseline best, and it.

    Baselines undo the motion during a scan to an instant of their own choice.
    """
    times = frames[0].scan.times
    assert times is not None
    span_s = float(times.max())
    best: tuple[float, F64, float] | None = None
    for instant in _INSTANTS:
        moved = _at(truth, np.array([f.scan.stamp * 1e-9 for f in frames]), instant * span_s)
        off = _ate_m(estimate, moved)
        if best is None or off < best[0]:
            best = off, moved, instant
    assert best is not None
    return best[1], best[2]


def _at(truth: F64, stamps_s: F64, later_s: float) -> F64:
    """Poses so much after each stamp, at the velocity to the next frame (or from the last)."""
    moved = []
    for k, T in enumerate(truth):
        i = min(k, len(truth) - 2)
        step = se3.log(se3.inverse(truth[i]) @ truth[i + 1])
        moved.append(T @ se3.exp(step * (later_s / (stamps_s[i + 1] - stamps_s[i]))))
    return np.array(moved)


def _ate_m(estimate: F64, truth: F64) -> float:
    """RMSE of positions after alignment, metres."""
    off = aligned(estimate, truth)[:, :3, 3] - truth[:, :3, 3]
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def _scores(
    estimate: F64, truth: F64, rows: list[dict[str, Any]], sequence: Sequence
) -> dict[str, Any]:
    """Scores of the whole run; adds the errors of each step to the rows."""
    metres, degrees = step_errors(estimate, truth)
    limit_m, limit_deg = sequence.limits
    anchor = 0
    for k in range(1, len(rows)):
        right = metres[k - 1] <= limit_m and degrees[k - 1] <= limit_deg
        since_m, since_deg = step_errors(estimate[[anchor, k]], truth[[anchor, k]])
        # A pose that is right again after a wrong one has two wrong steps but one wrong pose.
        pose_right = bool(right or (since_m[0] <= limit_m and since_deg[0] <= limit_deg))
        rows[k] |= {
            'step_m': float(metres[k - 1]),
            'step_deg': float(degrees[k - 1]),
            'step_right': bool(right),
            'pose_right': pose_right,
        }
        anchor = k if pose_right else anchor
    path = float(path_lengths(truth)[-1])
    ate = _ate_m(estimate, truth)
    steps = max(1, len(rows) - 1)
    return {
        'frames': len(rows),
        'path_m': path,
        'ate_m': ate,
        'ate_percent': 100.0 * ate / path if path > 0.0 else None,
        'step_median_mm': 1e3 * float(np.median(metres)),
        'step_mean_mm': 1e3 * float(metres.mean()),
        'step_max_mm': 1e3 * float(metres.max()),
        'right_share': sum(bool(r.get('step_right')) for r in rows) / steps,
        'lost': sum(r['source'] == 'lost' for r in rows),
    }
