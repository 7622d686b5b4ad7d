# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pairs of lidar scans of one street: choose places and times, scan, crop, measure overlap."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.se3 import apply, inverse
from hybridreg_ros.data.hybridmatch.stage import displacement_m
from hybridreg_ros.data.hybridmatch.take import Sample
from hybridreg_ros.data.hybridmatch.truth import Truth
from hybridreg_ros.data.meshes.geometry import voxel_thin
from hybridreg_ros.data.meshes.raycast import Caster
from hybridreg_ros.data.overlap import near_cells
from hybridreg_ros.data.pair import PointPair
from hybridreg_ros.data.sensors.lidar import SpinningLidar, random_lidar
from hybridreg_ros.data.streets.outdoors import StreetWorld, make_street

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.hybridmatch.cell import Cell
    from hybridreg_ros.data.meshes.scene import Scene

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

VOXEL_SIZE_M = 0.3
_SEEN_M = 0.3
_MIN_POINTS = 1500
_MAX_POINTS = 15000
_MIN_SHARED = 250
_RAYS, _FEWEST_COLUMNS = 80_000, 720
_DESKEW_ERROR = 0.03
_SOME_STAND = 0.3
_CROPS_M = (80.0, 60.0, 45.0, 34.0, 26.0, 20.0, 15.0, 12.0)


@dataclass(frozen=True, eq=False)
class _SensorView:
    """One scan as a list of points, deskewed as well as a real front end can.

    Attributes:
        points: (N, 3) float32 measured, sensor frame at the stamp.
        true: (N, 3) float32 without noise.
        label: (N,) uint8.
        instance: (N,) uint16.
        crowd: (N,) bool what could move, whether or not it does.
        plane: (N,) number of the large flat part, 0 = none.
        sigma_m: (N,) float32 standard deviation of the error of each point.
        T_world_sensor: (4, 4) at the stamp.
        time_s: of the stamp.
    """

    points: F32
    true: F32
    label: NDArray[np.uint8]
    instance: NDArray[np.uint16]
    crowd: NDArray[np.bool_]
    plane: NDArray[np.int32]
    sigma_m: F32
    T_world_sensor: F64
    time_s: float

    def rows(self, keep: NDArray[np.int64]) -> _SensorView:
        """The view of some points."""
        return _SensorView(
            self.points[keep],
            self.true[keep],
            self.label[keep],
            self.instance[keep],
            self.crowd[keep],
            self.plane[keep],
            self.sigma_m[keep],
            self.T_world_sensor,
            self.time_s,
        )

    @cached_property
    def polar(self) -> tuple[F32, F32]:
        """Distance (N,) from the sensor's axis, metres, and angle (N,) off straight ahead."""
        x, y = self.points[:, 0], self.points[:, 1]
        off: F32 = np.abs((np.arctan2(y, x) + np.pi) % (2.0 * np.pi) - np.pi)
        return np.hypot(x, y), off


@dataclass(frozen=True, eq=False)
class _Crop:
    """What is kept of both scans.

    Attributes:
        range_m: farthest point.
        drop: numbers of the flat parts that are removed.
        sector: half width of the azimuth that is kept, about straight ahead, radians.
        thin_m: voxel of the thinned clouds.
    """

    range_m: float
    drop: NDArray[np.int32]
    sector: float
    thin_m: float

    def of(self, view: _SensorView) -> _SensorView:
        """The kept and thinned points of a view."""
        away, off = view.polar
        stays = np.ones(max(view.plane.max(initial=0), self.drop.max(initial=0)) + 1, np.bool_)
        stays[self.drop] = False
        rows = np.flatnonzero((away < self.range_m) & (off < self.sector) & stays[view.plane])
        points, voxel = view.points[rows], self.thin_m
        thin = voxel_thin(points, voxel)
        while len(thin) > _MAX_POINTS:
            voxel *= max(1.1, float(np.sqrt(len(thin) / _MAX_POINTS)))
            thin = voxel_thin(points, voxel)
        return view.rows(rows[thin])


def street_cell(
    seed: int, cell: Cell, count: int = 4, *, still: bool = False, name: str = 'street'
) -> list[Sample]:
    """Pairs of one random street that belong to a cell, at most `count`.

    Args:
        seed: of everything.
        cell: what the pairs must be.
        count: most pairs.
        still: take every target without motion, too.
        name: begin of the pairs' names.
    """
    rng = np.random.default_rng([seed, 3])
    wanted = cell.crowd or (cell.dynamic if not cell.frozen else (0.1, 0.3))
    low_overlap = cell.overlap[1] <= 0.5
    world = make_street(rng, None, (min(wanted[0], 0.9), min(wanted[1], 1.0)), travel_m=45.0)
    lidar = _affordable(random_lidar(rng))
    samples: list[Sample] = []
    speed = world.path.ride.speed_mps
    first_s = float(rng.uniform(0.0, 15.0)) / speed
    # Seen from far apart: what stands is spread over the way between both places.
    until_s = first_s + (25.0 / speed if low_overlap else 0.0)
    caster = _with_some_moving(rng, Caster(world.scene), cell, (first_s, until_s))
    target = _take(rng, world, caster, lidar, first_s, None)
    for k in range(count):
        own = np.random.default_rng([seed, 4, k])
        baseline = float(own.uniform(5.0, 25.0) if low_overlap else own.uniform(0.5, 12.0))
        time_s = target.time_s + max(baseline / speed, float(own.uniform(0.25, 0.6)))
        source = _take(own, world, caster, lidar, time_s, None, shift=True)
        made = _fit(own, source, target, cell)
        if made is None:
            continue
        pair, crop, sigma, seen = made
        twin = None
        if still:
            twin = (
                pair.target
                if cell.frozen
                else crop.of(
                    _take(own, world, caster, lidar, target.time_s, time_s, pose=target)
                ).points
            )
        pair = replace(pair, name=f'{name}-{seed:07d}-{k}', seed=seed)
        truth = Truth(
            caster.scene.movers, (time_s, target.time_s), source.T_world_sensor, sigma, seen
        )
        moved_m = _displacement(caster.scene, pair, target.time_s, time_s)
        samples.append(Sample(pair, moved_m, truth, twin))
    return samples


def _with_some_moving(
    rng: np.random.Generator, caster: Caster, cell: Cell, times_s: tuple[float, float]
) -> Caster:
    """The scene in which as much moves as a cell asks for.

    The rest stands, each thing as at a random one of some times.
    """
    chance = 1.0
    if cell.frozen:
        chance = 0.0
    elif cell.part and cell.crowd is not None:
        chance = float(rng.uniform(*cell.dynamic)) / float(np.mean(cell.crowd))
    elif cell.crowd is None and rng.random() < _SOME_STAND:
        chance = float(rng.uniform(0.3, 0.9))
    moves = rng.random(len(caster.scene.movers)) < chance
    if moves.all():
        return caster
    since = rng.uniform(*times_s, len(moves)) if times_s[0] < times_s[1] else times_s[0]
    return caster.halted(moves, since)


def _affordable(lidar: SpinningLidar) -> SpinningLidar:
    """The lidar with fewer columns if it has many beams; 16 and 32 beams keep all of them."""
    most = max(_FEWEST_COLUMNS, _RAYS // len(lidar.elevation_deg))
    return replace(lidar, columns=min(lidar.columns, most))


def _take(
    rng: np.random.Generator,
    world: StreetWorld,
    caster: Caster,
    lidar: SpinningLidar,
    time_s: float,
    frozen_s: float | None,
    *,
    shift: bool = False,
    pose: _SensorView | None = None,
) -> _SensorView:
    """Scan from the way at a time, or with `pose` from exactly that view's place.

    The scan is taken on the move and deskewed with a slightly wrong velocity, as a front end
    would do.
    """
    path = world.path
    s = path.ride.start_m + path.ride.speed_mps * time_s
    offset = float(rng.normal(0.0, 0.25)) if shift else 0.0
    sharp = rng.random() < 0.25
    turn = float(rng.normal(0.0, 0.6 if sharp else 0.12)) if shift else 0.0
    speed = path.ride.speed_mps * float(rng.uniform(0.0, 1.0))
    if pose is not None:
        place = pose.T_world_sensor

    def pose_at(t: float) -> F64:
        if pose is not None:
            return place
        return path.pose_from(s + speed * (t - time_s), t, offset_m=offset, turn_rad=turn)

    scan = lidar.scan(caster, time_s, pose_at, rng, loss=world.loss, frozen_s=frozen_s)
    wrong = 1.0 + float(rng.normal(0.0, _DESKEW_ERROR))
    raw, best = scan.points, scan.deskewed()
    points = (raw + np.float32(wrong) * (best - raw)).reshape(-1, 3)
    rows = np.nonzero(np.isfinite(points).all(1))[0]
    rows = rows[np.argsort(rng.random(len(rows)), kind='stable')]
    plane = np.append(world.plane, 0)[scan.face.reshape(-1)[rows]]
    label, instance = scan.label.reshape(-1)[rows], scan.instance.reshape(-1)[rows]
    skew = np.linalg.norm((best - raw).reshape(-1, 3)[rows], axis=1)
    sigma = np.hypot(lidar.sigma_m(np.linalg.norm(points[rows], axis=1)), _DESKEW_ERROR * skew)
    crowd = scan.mover.reshape(-1)[rows]
    return _SensorView(
        points[rows],
        scan.true.reshape(-1, 3)[rows],
        label,
        instance,
        crowd,
        plane.astype(np.int32),
        sigma,
        pose_at(time_s),
        time_s,
    )


def _fit(
    rng: np.random.Generator, source: _SensorView, target: _SensorView, cell: Cell
) -> tuple[PointPair, _Crop, F32, NDArray[np.bool_]] | None:
    """The first of some random crops with which a pair suits its cell, None when none does.

    Returns:
        The pair, the crop, and of each source point the standard deviation (N,) of its error and
        whether (N,) it is static and seen by the target.
    """
    T = inverse(target.T_world_sensor) @ source.T_world_sensor
    planes = np.unique(np.concatenate([source.plane, target.plane]))
    ranges = rng.permutation(_CROPS_M)
    thin = float(rng.uniform(0.12, 0.16))
    for far in ranges:
        for whole in (True, False):
            chance = np.where(planes == 1, 0.85, 0.7) * (0.3 if whole else 1.0)
            drop = planes[(planes > 0) & (rng.random(len(planes)) < chance)]
            wide = np.pi if rng.random() < 0.7 else float(rng.uniform(0.9, 2.4))
            crop = _Crop(float(far), drop, wide, thin)
            mine = crop.of(source)
            if len(mine.points) < _MIN_POINTS:
                continue
            made = _measure(mine, crop.of(target), T, cell)
            if made is not None:
                return made[0], crop, mine.sigma_m, made[1]
    return None


def _measure(
    source: _SensorView, target: _SensorView, T: F64, cell: Cell
) -> tuple[PointPair, NDArray[np.bool_]] | None:
    """The pair of two cropped views and which source points are seen; None if it suits not."""
    if min(len(source.points), len(target.points)) < _MIN_POINTS:
        return None
    s_label, t_label = source.label, target.label
    share = float(np.concatenate([s_label, t_label]).astype(np.bool_).mean())
    if not cell.frozen and not cell.dynamic[0] <= share <= cell.dynamic[1]:
        return None
    crowd = float(np.concatenate([source.crowd, target.crowd]).mean())
    if cell.crowd is not None and not cell.crowd[0] <= crowd <= cell.crowd[1]:
        return None
    mine = apply(T, source.true[s_label == 0].astype(np.float64)).astype(np.float64)
    seen = near_cells(mine, target.true[t_label == 0].astype(np.float64), _SEEN_M)
    overlap = float(seen.mean()) if len(seen) else 0.0
    if not cell.overlap[0] < overlap < cell.overlap[1] or seen.sum() < _MIN_SHARED:
        return None
    both = np.zeros(len(s_label), np.bool_)
    both[s_label == 0] = seen
    pair = PointPair(
        source.points,
        target.points,
        T,
        s_label,
        t_label,
        source.instance,
        target.instance,
        overlap,
        share,
        VOXEL_SIZE_M,
    )
    return pair, both


def _displacement(scene: Scene, pair: PointPair, first_s: float, second_s: float) -> float:
    """Mean displacement of the vertices of the mover that shows most points, metres."""
    seen = np.concatenate([pair.source_instance, pair.target_instance])
    if not seen.any():
        return 0.0
    key = scene.movers[int(np.bincount(seen[seen > 0]).argmax()) - 1]
    return displacement_m(key, first_s, second_s)
