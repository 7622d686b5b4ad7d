# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A map of what stands still, cleaned by what every scan, earlier or later, saw through."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.dynamics.cells import Cells, Grid
from hybridreg_ros.odometry.map.thinning import first_per_voxel, occupied
from hybridreg_ros.odometry.preprocess import SensorModel, recognise_sensor
from hybridreg_ros.odometry.result import Source
from hybridreg_ros.odometry.visibility.range_image import FRONT, ON, Pixels, RangeImage, view_of
from hybridreg_ros.replay.runner import DYNAMIC_THRESHOLD, true_dynamic

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.result import OdometryResult

    _Looks = tuple[NDArray[np.int64], NDArray[np.float64]]
    """Keys (N,) of cells, and (2, N) how often they were seen through, and how often not."""

STILL, MOVING, UNKNOWN = 0, 1, 255
"""Labels of points."""
_SLACK, _SLACK_SHARE = 0.25, 0.0075
"""How far off a seen surface is still on it, in voxels and as a share of the range."""
_LEAST, _SHARE = 2.0, 0.1
"""A cell is a ghost when two looks or more, and a tenth of those that saw it, saw through it."""
_IMAGES = 500
"""Range images that are kept; of a longer run every second, third, ... scan has one."""
_APART = sorted({int(1.25**k) for k in range(40)})
"""How many images before and after a scan it is compared with: near ones and far ones."""
_FINE = 0.33
"""Spacing of the points of the map, voxels of the odometry."""
_MERGE = 2_000_000


@dataclass(frozen=True)
class MapReport:
    """What was done, and how well where labels exist.

    Attributes:
        scans: scans that the map is made of.
        points: points of these scans.
        moving: of them, called moving by the odometry.
        ghosts: further points, taken out since other scans saw through their place, or that of
            the thing that they belong to.
        written: points of the map.
        static_accuracy: share of the points that stand still that is kept; None without labels.
        dynamic_accuracy: share of the moving points that is taken out.
        accuracy: geometric mean of both.
    """

    scans: int
    points: int
    moving: int
    ghosts: int
    written: int
    static_accuracy: float | None = None
    dynamic_accuracy: float | None = None
    accuracy: float | None = None


@dataclass(frozen=True, eq=False)
class CleanMap:
    """Points (N, 3) and (M, 3) float32 of odom, metres: what stands still, and what moved."""

    still: NDArray[np.float32]
    moving: NDArray[np.float32]
    report: MapReport


class MapSink:
    """Keeps the scans of a run in a temporary file, 14 bytes per point, for the map at its end.

    Args:
        folder: where the file lies.
        threshold: dynamic probability from which a point counts as moving.
        config: settings; the sensor is recognised by the first scan.
    """

    def __init__(
        self,
        folder: Path,
        threshold: float = DYNAMIC_THRESHOLD,
        config: OdometryConfig | None = None,
    ) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 (see close)
        self._threshold = threshold
        self._config = config or OdometryConfig()
        self._sensor: SensorModel | None = None
        self._view: Pixels | None = None
        self._poses: list[NDArray[np.float64]] = []
        self._sizes: list[int] = []

    def add(self, message: Any, result: OdometryResult) -> None:
        """Keep one scan, unless its pose is lost."""
        if result.source is Source.LOST:
            return
        truth = true_dynamic(message, result.scan)
        labels = np.full(len(result.scan), UNKNOWN) if truth is None else truth
        called = result.dynamic_probability >= self._threshold
        self.offer(result.pose, result.scan.points, called, labels.astype(np.uint8))

    def offer(
        self,
        pose: NDArray[np.float64],
        points: NDArray[np.float32],
        moving: NDArray[np.bool_],
        labels: NDArray[np.uint8],
    ) -> None:
        """Keep points (N, 3) of the sensor frame at a pose, which of them move, and the truth."""
        if self._sensor is None and len(points):
            self._sensor = recognise_sensor(points, self._config)
            self._view = view_of(points, self._sensor.kind)
        for part in (points.astype(np.float32), moving.astype(np.uint8), labels):
            self._file.write(np.ascontiguousarray(part).tobytes())
        self._poses.append(pose)
        self._sizes.append(len(points))

    def close(self) -> None:
        """Give the file back."""
        self._file.close()

    def _scan(self, k: int) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.uint8]]:
        n = self._sizes[k]
        self._file.seek(14 * sum(self._sizes[:k]))
        raw = self._file.read(14 * n)
        points = np.frombuffer(raw, np.float32, 3 * n).reshape(-1, 3)
        moving, labels = np.frombuffer(raw, np.uint8, 2 * n, 12 * n).reshape(2, n)
        return points, moving.astype(np.bool_), labels

    def make(self) -> CleanMap:
        """The map: every point is asked for in other scans, then the ghosts are left out."""
        empty = np.zeros((0, 3), np.float32)
        if self._sensor is None:
            return CleanMap(empty, empty, MapReport(0, 0, 0, 0, 0))
        ghosts = self._ghost_cells()
        size_m = self._sensor.voxel_size_m
        still, moved = [empty], [empty]
        tally = np.zeros((2, 2), np.int64)
        moving_points = ghost_points = 0
        for k, pose in enumerate(self._poses):
            points, moving, labels = self._scan(k)
            placed = se3.apply(pose, points)
            _, _, keys, _, _, cell = occupied(placed, size_m, np.ones(len(placed), np.bool_))
            ghost = np.isin(keys, ghosts)[cell] & (cell >= 0) if len(keys) else moving
            out = self._wholly(points, moving | ghost)
            moving_points += int(moving.sum())
            ghost_points += int((out & ~moving).sum())
            for truth in (STILL, MOVING):
                tally[truth] += np.bincount(out[labels == truth], minlength=2)
            still.append(placed[~out])
            moved.append(placed[out])
            if sum(map(len, still)) + sum(map(len, moved)) > _MERGE or k == len(self._poses) - 1:
                still, moved = ([_thinned(part, _FINE * size_m)] for part in (still, moved))
        scores = _accuracies(tally)
        made = MapReport(
            len(self._sizes), sum(self._sizes), moving_points, ghost_points, len(still[0]), *scores
        )
        return CleanMap(still[0], moved[0], made)

    def _wholly(self, points: NDArray[np.float32], out: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """What is taken out of a scan (N,), and all of the things that it is a third of."""
        assert self._sensor is not None
        assert self._view is not None
        grid = Grid.of(self._sensor.voxel_size_m, self._view.step_rad)
        cells = Cells.of(points, np.ones(len(points), np.int32), np.eye(4), grid)
        part, count = cells.parts
        inside = np.flatnonzero(cells.of_point >= 0)
        of_point = part[cells.of_point[inside]]
        gone = np.bincount(of_point, out[inside], count)
        out = out.copy()
        out[inside] |= (3.0 * gone > np.bincount(of_point, minlength=count))[of_point]
        return out

    def _ghost_cells(self) -> NDArray[np.int64]:
        """Keys of the cells of odom that were seen through."""
        assert self._sensor is not None
        waiting: list[_Looks] = []
        for placed, front, on in self._looks():
            everywhere = np.ones(len(placed), np.bool_)
            _, _, keys, _, _, cell = occupied(placed, self._sensor.voxel_size_m, everywhere)
            inside = cell >= 0
            sums = [np.bincount(cell[inside], v[inside], len(keys)) for v in (front, on)]
            waiting.append((keys, np.stack(sums)))
            if sum(len(w[0]) for w in waiting) > _MERGE:
                waiting = [_summed(waiting)]
        keys, (front, on) = _summed(waiting)
        ghost: NDArray[np.int64] = keys[(front >= _LEAST) & (front > _SHARE * on)]
        return ghost

    def _looks(
        self,
    ) -> Iterator[tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]]:
        """Of each scan its points in odom, how often they were seen through, and how often not."""
        assert self._sensor is not None
        assert self._view is not None
        slack = _SLACK * self._sensor.voxel_size_m
        every = -(-len(self._poses) // _IMAGES)
        drawn = range(0, len(self._poses), every)
        images = [RangeImage(self._scan(k)[0], self._view, self._poses[k]) for k in drawn]
        for k, pose in enumerate(self._poses):
            points = self._scan(k)[0]
            front, on = np.zeros((2, len(points)), np.int32)
            near = k // every
            for j in sorted({near + s * d for d in (0, *_APART) for s in (-1, 1)}):
                if 0 <= j < len(images) and drawn[j] != k:
                    stand = images[j].stand(points, pose, slack, _SLACK_SHARE, strict=True)
                    front += stand == FRONT
                    on += stand == ON
            yield se3.apply(pose, points), front, on


def _summed(parts: list[_Looks]) -> _Looks:
    """Looks at equal cells added up."""
    unique, place = np.unique(np.concatenate([keys for keys, _ in parts]), return_inverse=True)
    looks = np.concatenate([both for _, both in parts], axis=1)
    return unique, np.stack([np.bincount(place, row, len(unique)) for row in looks])


def _thinned(parts: list[NDArray[np.float32]], size_m: float) -> NDArray[np.float32]:
    points = np.concatenate(parts)
    return points[first_per_voxel(points, size_m)]


def _accuracies(tally: NDArray[np.int64]) -> tuple[float | None, float | None, float | None]:
    """Static and dynamic accuracy and their geometric mean; None where nothing is labelled."""
    (kept, lost), (left, removed) = tally.tolist()
    static = kept / (kept + lost) if kept + lost else None
    dynamic = removed / (left + removed) if left + removed else None
    both = None if static is None or dynamic is None else float(np.sqrt(static * dynamic))
    return static, dynamic, both
