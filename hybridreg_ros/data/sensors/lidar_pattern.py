# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Lidars that look ahead only: a few beams that mirrors or prisms swing over a narrow field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.sensors.lidar import SpinningLidar

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True, eq=False)
class PatternLidar(SpinningLidar):
    """A lidar whose beams swing to and fro in both directions, so that no scan repeats another.

    Elevation and azimuth of the beams are those at rest.

    Attributes:
        swing_deg: largest azimuth and elevation of the swing.
        swing_hz: swings a second in azimuth and in elevation.
        phase_s: time at which the scan begins.
    """

    swing_deg: tuple[float, float] = (35.0, 12.0)
    swing_hz: tuple[float, float] = (211.6, 88.6)
    phase_s: float = 0.0

    def directions(self) -> F32:
        """Unit directions (H, W, 3) of all beams in the sensor frame of their own time."""
        t = self.phase_s + np.arange(self.columns) / (self.columns * self.rate_hz)
        across, up = (
            np.deg2rad(size) * _triangle(rate * t)
            for size, rate in zip(self.swing_deg, self.swing_hz, strict=True)
        )
        azimuth = across + np.deg2rad(self.offset_deg)[:, None]
        elevation = up + np.deg2rad(self.elevation_deg)[:, None]
        level = np.cos(elevation)
        rays = [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)]
        return np.stack(rays, axis=-1).astype(np.float32)


def _triangle(turns: F64) -> F64:
    """Triangle wave (N,) between -1 and 1 of a number of turns (N,)."""
    return 4.0 * np.abs(turns % 1.0 - 0.5) - 1.0


def rosette(rng: np.random.Generator) -> PatternLidar:
    """Six beams on prisms: about 70 by 25 degrees, 24,000 rays a scan."""
    return PatternLidar(
        np.linspace(1.3, -1.3, 6),
        np.zeros(6),
        4000,
        range_m=(1.0, 150.0),
        noise_m=0.015,
        reach_m=80.0,
        swing_deg=(float(rng.uniform(33.0, 37.0)), float(rng.uniform(10.0, 12.0))),
        swing_hz=(211.0 + _GOLDEN, 89.0 - 0.7 * _GOLDEN),
        seed=int(rng.integers(2**31)),
    )


def raster(rng: np.random.Generator) -> PatternLidar:
    """Five lasers side by side on a mirror: 120 by 25 degrees, 78,000 rays a scan."""
    return PatternLidar(
        np.zeros(5),
        np.linspace(48.0, -48.0, 5),
        15_600,
        range_m=(0.5, 150.0),
        noise_m=0.02,
        reach_m=80.0,
        swing_deg=(12.5, float(rng.uniform(12.0, 13.0))),
        swing_hz=(630.0, 5.0 + 0.1 * _GOLDEN),
        seed=int(rng.integers(2**31)),
    )
