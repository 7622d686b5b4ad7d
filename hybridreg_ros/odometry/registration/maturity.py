# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Maturity: surfaces that have been there for a while hold a scan, new ones hardly do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.odometry.registration.kernels import NONE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import RefineConfig
    from hybridreg_ros.odometry.registration.surfaces import Surfaces

    F64 = NDArray[np.float64]

_FULL = 0.8
"""Quantile of the weights of the trusted points that is raised to 1: only the difference between
old and young counts, so a scan that sees nothing old is held as firmly as one that does."""
_FEW = 50
"""Of fewer points with surfaces, no quantile is taken."""


def by_age(trust: F64, surfaces: Surfaces, age_s: float, config: RefineConfig) -> F64:
    """Weights (N,) of points, lowered where the surfaces that they meet are young.

    A thing that moves without being known for it leaves new surfaces behind wherever it comes,
    and the next scan, in which it has moved on a little, is drawn along by them. What stands still
    keeps its surfaces, however the sensor moves. New surfaces also share the error of the last
    pose, which would be handed on.

    Args:
        trust: (N,) weights in [0, 1].
        surfaces: of N points, as searched last.
        age_s: age of the map; while that is less than `mature_s`, its first surfaces count fully.
        config: `mature_s` and `young`.
    """
    span_s = min(config.mature_s, age_s)
    used = (surfaces.kind != NONE) & (trust > 0.5)
    if span_s <= 0.0 or used.sum() < _FEW:
        return trust
    share = np.clip((age_s - surfaces.born) / span_s, 0.0, 1.0)
    weight = config.young + (1.0 - config.young) * share
    full = max(float(np.quantile(weight[used], _FULL)), 1e-6)
    lowered: F64 = trust * np.minimum(1.0, weight / full)
    return lowered
