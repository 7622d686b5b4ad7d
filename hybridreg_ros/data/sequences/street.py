# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated lidar sequences: a spinning lidar travels through a street in which things move."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.data.meshes.raycast import Caster
from hybridreg_ros.data.sensors.lidar import SpinningLidar, random_lidar
from hybridreg_ros.data.sequences.frame import LIDAR_FRAME, SHARES, SimulatedFrame, miss
from hybridreg_ros.data.streets.outdoors import StreetWorld, make_street

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

_LOG = logging.getLogger(__name__)

_TOP_SPEED_MPS = 12.0
_MAX_TRAVEL_M = 4900.0
_ATTEMPTS = 4
_GLANCES = 5


@dataclass(frozen=True, eq=False)
class _Drive:
    """A street, a lidar on its way, and the share of moving points it will see."""

    world: StreetWorld
    caster: Caster
    lidar: SpinningLidar
    share: float


def street_frames(
    times: F64, rate_hz: float, seed: int, dynamic: str, columns: int | None = None
) -> Iterator[SimulatedFrame]:
    """Frames of a lidar sequence; each is one turn that starts at its stamp.

    Points are as measured, each in the sensor frame of its own time (not deskewed).

    Args:
        times: (N,) stamps, seconds from the start.
        rate_hz: turns a second.
        seed: of everything random.
        dynamic: share of moving points aimed at: 'none', '10-30' or '30-50' percent.
        columns: columns of a turn; by default those of the device.

    Raises:
        ConfigError: the sequence is longer than a street can be.
    """
    travel = _TOP_SPEED_MPS * (float(times[-1]) + 1.0 / rate_hz) + 5.0
    if travel > _MAX_TRAVEL_M:
        longest = int(_MAX_TRAVEL_M / _TOP_SPEED_MPS * rate_hz)
        raise ConfigError(
            f'frames: expected at most {longest} at {rate_hz:g} Hz, found {len(times)}'
        )
    drive = _plan(times, travel, rate_hz, seed, dynamic, columns)
    _LOG.info(
        'street of seed %d: %s, about %.0f %% moving points',
        seed,
        drive.world.kind,
        100.0 * drive.share,
    )
    return _frames(drive, times, seed)


def _frames(drive: _Drive, times: F64, seed: int) -> Iterator[SimulatedFrame]:
    path, lidar = drive.world.path, drive.lidar
    for k, time_s in enumerate(times.tolist()):
        rng = np.random.default_rng([seed, 21, k])
        scan = lidar.scan(drive.caster, time_s, path.pose_at, rng, loss=drive.world.loss)
        rings, columns = scan.label.shape
        yield SimulatedFrame(
            scan.points.reshape(-1, 3),
            (rings, columns),
            np.tile(scan.times, rings),
            time_s,
            path.pose_at(time_s),
            scan.label.reshape(-1),
            scan.instance.reshape(-1),
            LIDAR_FRAME,
        )


def _plan(
    times: F64, travel_m: float, rate_hz: float, seed: int, dynamic: str, columns: int | None
) -> _Drive:
    """The best of a few random streets for the share of moving points asked for."""
    best: _Drive | None = None
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, 20, attempt])
        world = make_street(rng, None, SHARES[dynamic], travel_m=travel_m)
        lidar = replace(random_lidar(rng, columns=columns), rate_hz=rate_hz)
        caster = Caster(world.scene)
        drive = _Drive(world, caster, lidar, _share(world, caster, lidar, times))
        if best is None or miss(drive.share, SHARES[dynamic]) < miss(best.share, SHARES[dynamic]):
            best = drive
        if miss(best.share, SHARES[dynamic]) == 0.0:
            break
    assert best is not None
    return best


def _share(world: StreetWorld, caster: Caster, lidar: SpinningLidar, times: F64) -> float:
    """Mean share of moving points of a few coarse scans along the way."""
    if not world.scene.movers:
        return 0.0
    coarse = replace(lidar, columns=90)
    shares = []
    for time_s in np.linspace(times[0], times[-1], min(_GLANCES, len(times))).tolist():
        rng = np.random.default_rng(0)
        scan = coarse.scan(
            caster, time_s, world.path.pose_at, rng, loss=world.loss, frozen_s=time_s
        )
        seen = np.isfinite(scan.points[..., 0])
        shares.append(float((scan.label > 0)[seen].mean()) if seen.any() else 0.0)
    return float(np.mean(shares))
