# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Spinning lidar: beam tables, noise, dropout, and one pose per column of the scan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.data.meshes.geometry import SmoothNoise
from hybridreg_ros.data.sensors.lidar_cast import cast_turn
from hybridreg_ros.data.sensors.lidar_tables import TABLES

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hybridreg_ros.data.meshes.raycast import Caster

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

_EXACT_POSES = 16


@dataclass(frozen=True, eq=False)
class LidarScan:
    """One turn of a lidar: H rings (top first) by W columns (in the order of time).

    Attributes:
        points: (H, W, 3) float32 as measured: each in the sensor frame of its own time, metres;
            NaN where there is no return.
        times: (W,) float64 seconds of each column after the start of the scan.
        true: (H, W, 3) float32 without noise, sensor frame at the start of the scan; NaN where
            there is no return.
        label: (H, W) uint8 of `Label`.
        instance: (H, W) uint16, 0 = background.
        mover: (H, W) bool what could move, also where it stands.
        face: (H, W) int32 static triangle, -1 at movers and misses.
        T_start_column: (W, 4, 4) pose of the sensor at each column in its frame at the start.
    """

    points: F32
    times: F64
    true: F32
    label: NDArray[np.uint8]
    instance: NDArray[np.uint16]
    mover: NDArray[np.bool_]
    face: NDArray[np.int32]
    T_start_column: F64

    def deskewed(self) -> F32:
        """Measured points (H, W, 3) in the sensor frame at the start of the scan."""
        R = self.T_start_column[:, :3, :3].astype(np.float32)
        t = self.T_start_column[:, :3, 3].astype(np.float32)
        moved: F32 = np.einsum('wij,hwj->hwi', R, self.points) + t
        return moved


@dataclass(frozen=True, eq=False)
class SpinningLidar:
    """A lidar that turns about its z axis, x ahead at the start of each scan.

    Attributes:
        elevation_deg: (H,) elevation of the beams, top first.
        offset_deg: (H,) azimuth of each beam in the column.
        columns: columns W of a turn.
        rate_hz: turns a second.
        range_m: shortest and longest range.
        noise_m: standard deviation of a range.
        ring_bias_m: standard deviation of each beam's constant error.
        dropout: share of rays lost at random.
        edge_mix: share of rays at edges that return something between both surfaces.
        reach_m: range at which a dark surface seen head-on is lost half of the time.
        quantum_m: step of the range output.
        clockwise: direction of the turn.
        seed: of this device's constant errors.
    """

    elevation_deg: F64
    offset_deg: F64
    columns: int = 1024
    rate_hz: float = 10.0
    range_m: tuple[float, float] = (0.6, 100.0)
    noise_m: float = 0.015
    ring_bias_m: float = 0.004
    dropout: float = 0.02
    edge_mix: float = 0.06
    reach_m: float = 60.0
    quantum_m: float = 0.002
    clockwise: bool = True
    seed: int = 0

    def directions(self) -> F32:
        """Unit directions (H, W, 3) of all beams in the sensor frame of their own time."""
        turn = -1.0 if self.clockwise else 1.0
        column = turn * 2.0 * np.pi * np.arange(self.columns) / self.columns
        azimuth = column + np.deg2rad(self.offset_deg)[:, None]
        elevation = np.deg2rad(self.elevation_deg)[:, None] + 0.0 * azimuth
        level = np.cos(elevation)
        rays = [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)]
        return np.stack(rays, axis=-1).astype(np.float32)

    def scan(
        self,
        caster: Caster,
        time_s: float,
        pose_at: Callable[[float], F64],
        rng: np.random.Generator,
        *,
        loss: F32 | None = None,
        frozen_s: float | None = None,
    ) -> LidarScan:
        """Take one scan that starts at a time.

        Args:
            caster: the scene.
            time_s: start of the scan, seconds.
            pose_at: T_world_sensor (4, 4) as a function of the time in seconds.
            rng: source of the noise.
            loss: (F,) share of lost rays per static triangle (glass), or None.
            frozen_s: the movers stand still as at this time; None lets them move.
        """
        times = np.arange(self.columns) / (self.columns * self.rate_hz)
        T_world = _column_poses(pose_at, time_s, times)
        rays = self.directions()
        d = np.einsum('wij,hwj->hwi', T_world[:, :3, :3], rays).astype(np.float32)
        o = np.broadcast_to(T_world[:, :3, 3].astype(np.float32), d.shape)
        distance, normal, instance, face = cast_turn(caster, o, d, time_s + times, frozen_s)
        lost = self._lost(rng, distance, normal, d, o, face, instance, loss)
        distance = np.where(lost, np.float32(np.nan), distance)
        instance = np.where(lost, 0, instance).astype(np.uint16)
        label = caster.labels(instance)
        T_start = np.einsum('ij,wjk->wik', se3.inverse(T_world[0]), T_world)
        true = (
            np.einsum('wij,hwj->hwi', T_start[:, :3, :3], rays * distance[..., None])
            + T_start[:, :3, 3]
        )
        measured = self._measured(rng, distance)
        return LidarScan(
            rays * measured[..., None],
            times,
            true.astype(np.float32),
            label,
            np.where(label > 0, instance, np.uint16(0)),
            instance > 0,
            np.where(lost, -1, face),
            T_start,
        )

    def _range_sigma_m(self, range_m: F32) -> F32:
        """Standard deviation of the random error of ranges."""
        sigma: F32 = self.noise_m * (1.0 + 0.004 * range_m)
        return sigma

    def sigma_m(self, range_m: F32) -> F32:
        """Standard deviation of all errors of ranges together, metres."""
        steady = self.ring_bias_m**2 + self.quantum_m**2 / 12.0
        sigma: F32 = np.sqrt(self._range_sigma_m(range_m) ** 2 + steady).astype(np.float32)
        return sigma

    def _lost(
        self,
        rng: np.random.Generator,
        distance: F32,
        normal: F32,
        d: F32,
        o: NDArray[np.float32],
        face: NDArray[np.int32],
        instance: NDArray[np.uint16],
        loss: F32 | None,
    ) -> NDArray[np.bool_]:
        """Which rays give no return: out of range, too dark, too oblique, glass, or by chance."""
        lost = ~((distance > self.range_m[0]) & (distance < self.range_m[1]))
        far = np.where(lost, 0.0, distance)
        facing = np.abs(np.einsum('hwi,hwi->hw', normal, d))
        device = np.random.default_rng(self.seed)
        paint = SmoothNoise(device, (0.4, 6.0), 0.5, waves=4)
        spot = (o + d * far[..., None]).reshape(-1, 3) + 7.0 * instance.reshape(-1, 1)
        bright = np.exp(paint(spot)).reshape(far.shape)
        strength = bright * (facing + 0.03) * (self.reach_m / np.maximum(far, 1.0)) ** 2
        chance = np.exp(-1.4 * strength) + self.dropout
        if loss is not None and len(loss):
            chance = chance + np.where(face >= 0, np.append(loss, 0.0)[face], 0.0)
        lost |= rng.random(far.shape) < chance
        return lost

    def _measured(self, rng: np.random.Generator, distance: F32) -> F32:
        """Ranges (H, W) with noise, beam errors, mixed returns at edges, and quantisation."""
        device = np.random.default_rng(self.seed + 1)
        bias = device.normal(0.0, self.ring_bias_m, (len(distance), 1))
        noise = self._range_sigma_m(np.nan_to_num(distance))
        r = distance + bias + noise * rng.normal(size=distance.shape)
        beyond = np.roll(distance, -1, axis=1)
        step = beyond - distance
        edge = (
            (np.abs(step) > 0.4) & (np.abs(step) < 3.0) & (rng.random(step.shape) < self.edge_mix)
        )
        r = np.where(edge, r + rng.random(step.shape) * step, r)
        return (np.round(r / self.quantum_m) * self.quantum_m).astype(np.float32)


def _column_poses(pose_at: Callable[[float], F64], start_s: float, times: F64) -> F64:
    """Poses (W, 4, 4) of all columns: exact at some, constant velocity in between."""
    knots = np.linspace(0, len(times), _EXACT_POSES + 1).astype(int)
    step = times[1] - times[0]
    exact = np.stack([pose_at(start_s + float(k * step)) for k in knots])
    T = np.empty((len(times), 4, 4))
    for k, (first, stop) in enumerate(pairwise(knots)):
        xi = se3.log(se3.inverse(exact[k]) @ exact[k + 1])
        share = np.arange(stop - first) / (stop - first)
        T[first:stop] = exact[k] @ _small_exp(share[:, None] * xi)
    return T


def _small_exp(xi: F64) -> F64:
    """Transforms (N, 4, 4) of twists (N, 6) of a few milliseconds, to third order in the angle."""
    W = np.zeros((len(xi), 3, 3))
    W[:, [2, 0, 1], [1, 2, 0]] = xi[:, 3:]
    W -= W.transpose(0, 2, 1)
    T = np.tile(np.eye(4), (len(xi), 1, 1))
    W2 = W @ W
    T[:, :3, :3] += W + 0.5 * W2 + W2 @ W / 6.0
    T[:, :3, 3] = xi[:, :3] + 0.5 * np.einsum('nij,nj->ni', W, xi[:, :3])
    return T


def make_lidar(model: str, *, columns: int | None = None, seed: int = 0) -> SpinningLidar:
    """A lidar with the beam table of a usual device.

    Args:
        model: one of `lidar_tables.TABLES`.
        columns: columns of a turn; by default the table's.
        seed: of the device's constant errors.

    Raises:
        ConfigError: the model is unknown, or too few columns are asked for.
    """
    if model not in TABLES:
        raise ConfigError(f'model: expected one of {", ".join(TABLES)}, found {model!r}')
    if columns is not None and columns < 16:
        raise ConfigError(f'columns: expected at least 16, found {columns}')
    table = TABLES[model]
    elevation = np.array(table.elevation_deg)
    offset = np.resize(np.array(table.offset_deg), len(elevation))
    return SpinningLidar(
        elevation,
        offset,
        columns or table.columns,
        range_m=table.range_m,
        noise_m=table.noise_m,
        reach_m=table.reach_m,
        clockwise=table.clockwise,
        seed=seed,
    )


def random_lidar(
    rng: np.random.Generator, *, columns: int | None = None, model: str | None = None
) -> SpinningLidar:
    """A usual device with its own small errors; a random one when no model is named."""
    model = str(rng.choice(list(TABLES))) if model is None else model
    lidar = make_lidar(model, columns=columns, seed=int(rng.integers(2**31)))
    crooked = rng.normal(0.0, 0.03, len(lidar.elevation_deg))
    return replace(
        lidar,
        elevation_deg=lidar.elevation_deg + crooked,
        noise_m=float(lidar.noise_m * rng.uniform(0.7, 1.5)),
        dropout=float(rng.uniform(0.005, 0.06)),
        reach_m=float(lidar.reach_m * rng.uniform(0.7, 1.2)),
    )
