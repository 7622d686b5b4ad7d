# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Surfaces: pairs of scan points with the map, their robust scales and weights by age."""

# ruff: noqa: D417 (kernels take plain arrays, named in `Surfaces`)
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray  # noqa: TC002 (numba reads the annotations of Surfaces)

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.odometry.registration.kernels import NONE, PLANE

_RANGE_GROUPS = 6
_RANGE_GROUP = 100
"""Points are grouped by range into at most so many groups of at least so many, each with a scale
of its own: the noise of a depth camera grows with the square of the range."""
MATURE_S, _YOUNG = 0.5, 0.1
"""Time after which a surface has full weight, and the weight of one that is new
(docs/lab/2026-11-23-old-surfaces-hold.md)."""
_FULL, _FEW = 0.8, 50
"""Quantile of the weights of the trusted points that is raised to 1: only the difference between
old and young counts, so a scan that sees nothing old is held as firmly as one that does. Of fewer
points with surfaces, none is taken."""


class Surfaces(NamedTuple):
    """What each of N scan points is paired with, map frame, metres.

    Attributes:
        kind: (N,) int8, NONE, POINT or PLANE.
        anchor: (N, 3) a point of the surface.
        normal: (N, 3) its unit normal (PLANE).
        variance: (N,) of the map points across the plane, m^2.
        born: (N,) age of the map, seconds, when its stored point was first seen.
        residual: (N,) distance of the point to it, as measured last.
    """

    kind: NDArray[np.int8]
    anchor: NDArray[np.float64]
    normal: NDArray[np.float64]
    variance: NDArray[np.float64]
    born: NDArray[np.float64]
    residual: NDArray[np.float64]


@compiled
def unpaired(count):  # type: ignore[no-untyped-def]
    """`Surfaces` of so many points, none of which is paired yet."""
    zeros = np.zeros(count)
    corner = np.zeros((count, 3))
    kind = np.zeros(count, np.int8)
    return Surfaces(kind, corner, corner.copy(), zeros, zeros.copy(), np.full(count, np.inf))


@compiled
def by_age(trust, surfaces, age_s, span_s):  # type: ignore[no-untyped-def]
    """Weights (N,) of points, lowered where the surfaces that they meet are young.

    A thing that moves without being known for it leaves new surfaces behind wherever it comes,
    and the next scan, in which it has moved on a little, is drawn along by them. What stands still
    keeps its surfaces, however the sensor moves. New surfaces also share the error of the last
    pose, which would be handed on.

    Args:
        trust: (N,) weights in [0, 1].
        age_s: age of the map.
        span_s: age at which a surface counts fully; 0 = all do.
    """
    if span_s <= 0.0:
        return trust
    weight = np.empty(len(trust))
    known, count = np.empty(len(trust)), 0
    for row in range(len(trust)):
        share = min(max((age_s - surfaces.born[row]) / span_s, 0.0), 1.0)
        weight[row] = _YOUNG + (1.0 - _YOUNG) * share
        if surfaces.kind[row] != NONE and trust[row] > 0.5:
            known[count] = weight[row]
            count += 1
    if count < _FEW:
        return trust
    rank = int(_FULL * (count - 1))
    full = max(np.sort(known[:count])[rank], 1e-6)
    for row in range(len(trust)):
        weight[row] = trust[row] * min(1.0, weight[row] / full)
    return weight


@compiled
def scales(surfaces, order, low, high):  # type: ignore[no-untyped-def]
    """Robust standard deviation of plane residuals per point (N,), as it grows with the range.

    Args:
        order: (N,) rows of the points by range.
        low: floor, metres.
        high: ceiling, metres.
    """
    n = len(order)
    planes = np.empty(n)
    place = np.empty(n)
    count = 0
    for k in range(n):
        if surfaces.kind[order[k]] == PLANE:
            planes[count] = surfaces.residual[order[k]]
            place[count] = k
            count += 1
    groups = max(1, min(_RANGE_GROUPS, count // _RANGE_GROUP))
    spread = np.empty(groups)
    middle = np.empty(groups)
    ends = np.linspace(0, count, groups + 1).astype(np.int64)
    for g in range(groups):
        if count == 0:
            spread[g], middle[g] = high, 0.0
            continue
        spread[g] = 1.4826 * np.median(planes[ends[g] : ends[g + 1]])
        middle[g] = place[(ends[g] + ends[g + 1]) // 2]
    out = np.empty(n)
    g = 0
    for k in range(n):
        while g + 1 < groups and middle[g + 1] <= k:
            g += 1
        value = spread[g]
        if k > middle[g] and g + 1 < groups:
            share = (k - middle[g]) / (middle[g + 1] - middle[g])
            value += share * (spread[g + 1] - spread[g])
        out[order[k]] = min(max(value, low), high)
    return out
