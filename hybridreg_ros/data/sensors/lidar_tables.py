# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Beam tables of spinning lidars: 16, 32, 64 and 128 beams, even and uneven."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class BeamTable:
    """What a kind of device has in common.

    Attributes:
        elevation_deg: elevation of each beam, top first.
        columns: columns of a turn at 10 Hz.
        offset_deg: azimuth of the beams in a column, repeated over the rings.
        range_m: shortest and longest range.
        noise_m: standard deviation of a range.
        reach_m: range at which dark surfaces begin to be lost.
        clockwise: direction of the turn seen from above.
    """

    elevation_deg: tuple[float, ...]
    columns: int
    offset_deg: tuple[float, ...] = (0.0,)
    range_m: tuple[float, float] = (0.6, 100.0)
    noise_m: float = 0.015
    reach_m: float = 60.0
    clockwise: bool = True


def _even(top: float, bottom: float, beams: int) -> tuple[float, ...]:
    return tuple(float(v) for v in np.linspace(top, bottom, beams))


def _dense_middle(top: float, bottom: float, beams: int, middle: float) -> tuple[float, ...]:
    """Beams that crowd around an elevation, as long-range devices have them."""
    s = np.linspace(-1.0, 1.0, beams)
    bent = 0.35 * s + 0.65 * s**3
    return tuple(
        float(middle - (b * (middle - bottom) if b > 0 else b * (top - middle))) for b in bent
    )


TABLES = {
    'even16': BeamTable(_even(15.0, -15.0, 16), 1800, range_m=(0.5, 100.0), noise_m=0.012),
    'even32': BeamTable(_even(10.67, -30.67, 32), 1800, range_m=(0.9, 80.0), noise_m=0.012),
    'dense32': BeamTable(
        _dense_middle(15.0, -25.0, 32, -1.0), 1800, (1.4, -1.4, 1.4, -4.2), (0.8, 120.0), 0.012
    ),
    'double64': BeamTable(
        _even(2.0, -8.33, 32) + _even(-8.83, -24.33, 32), 2000, (3.0, -3.0, 1.0, -1.0),
        (0.9, 100.0), 0.016, 70.0,
    ),
    'wide64': BeamTable(
        _even(22.5, -22.5, 64), 1024, (3.1, 1.0, -1.0, -3.1), (0.4, 100.0), 0.012, 50.0
    ),
    'narrow64': BeamTable(
        _even(16.6, -16.6, 64), 1024, (3.1, 1.0, -1.0, -3.1), (0.6, 120.0), 0.015, 60.0
    ),
    'dome64': BeamTable(
        _even(44.5, -44.5, 64), 1024, (3.1, 1.0, -1.0, -3.1), (0.3, 45.0), 0.01, 25.0
    ),
    'wide128': BeamTable(
        _even(21.0, -21.5, 128), 1024, (4.2, 1.4, -1.4, -4.2), (0.4, 120.0), 0.015, 60.0
    ),
    'dense128': BeamTable(
        _dense_middle(15.0, -25.0, 128, -2.0), 1800, (-1.5, 0.5, 1.5), (0.6, 150.0), 0.015, 90.0
    ),
}  # fmt: skip
