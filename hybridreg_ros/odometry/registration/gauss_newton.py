# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Gauss-Newton rounds of point-to-plane ICP against the map: pair, step, until it stands still."""

from __future__ import annotations

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.core.se3 import rotation_of, turn_of
from hybridreg_ros.odometry.registration.cluster_covariance import cluster_covariance
from hybridreg_ros.odometry.registration.kernels import (
    NONE,
    PLANE,
    associate,
    measure,
    normal_equations,
    scaled,
    units_of,
)
from hybridreg_ros.odometry.registration.surfaces import by_age, scales, unpaired

_STILL = 0.03
"""The iteration ends when a step is smaller than this, in voxels."""
_SHRINK, LEAST = 0.6, 0.02
"""Factor on the robust scale per iteration, and its floor, voxels."""
POINT_SPREAD = 5.0
"""Standard deviation of a point-to-point residual, in voxels: such pairs follow the pattern of the
rings rather than the surface, so they only hold what planes leave free."""
_LOOSE = 0.02
"""Share of the information of surfaces that face all ways that errors of normals alone give."""
_FIRST = 900
"""Points, about, by which an alignment near the expected pose comes close; all of them end it."""
_CLOSE = 0.1
"""Step, in voxels of the level, at which it has come close."""
_HELD = 0.007
"""Least share of the information of surfaces that face all ways that holds a direction: the median
of six ordinary sequences is 0.017 or more, of tunnels, rails, corridors, walls and fields 0.0033
or less (docs/lab/2026-11-29-what-holds-nothing.md)."""


@compiled
def settle(points, trust, order, T, grids, clock, course, prior):  # type: ignore[no-untyped-def]
    """Pair and step until the pose stands still.

    The robust scale starts no smaller than that of the course and shrinks (graduated
    non-convexity): a sharp kernel at a bad guess would keep only the pairs that happen to agree
    with the guess.

    Args:
        points: (N, 3) float64, sensor frame, metres.
        trust: (N,) weights in [0, 1].
        order: (N,) rows of the points by range.
        T: (4, 4) first guess.
        grids: the level and those that are asked for surfaces, as `associate` takes them.
        clock: updates of the map; its age, seconds; age at which a surface counts fully, seconds.
        course: first robust scale, voxels; most rounds.
        prior: (4, 4) pose that is expected; (6,) information along each axis of the odom frame
            (position, turn about the sensor), zero where nothing is expected.

    Returns:
        (4, 4) the pose, whether it stands where it was paired last, and the pairs.
    """
    floor, rounds = course
    expected, held = prior
    size, expects = grids[0].size, held.any()
    every = max(1, len(points) // _FIRST) if expects else 1
    some, weight, ranked = _every(every, points, trust, order)
    reach = _length(some[ranked[len(ranked) // 2]], 0) if len(some) else 1.0
    surfaces = unpaired(len(some))
    for _ in range(rounds):
        associate(some, T, grids, clock[0], surfaces)
        lasting = by_age(weight, surfaces, clock[1], clock[2])
        moved_m = 0.0
        for _ in range(2):
            measure(some, T, surfaces)
            scale = scales(surfaces, ranked, max(floor, LEAST) * size, size)
            H, b, any_way = normal_equations(
                some, lasting, T, surfaces, scale, (POINT_SPREAD * size) ** 2
            )
            if expects:
                H, b = believed(H, b, any_way)
                off = _off(T, expected)
                for i in range(6):
                    H[i, i] += held[i] / every
                    b[i] += held[i] / every * off[i]
            step = solve(H, b)
            T = _stepped(T, step)
            moved_m = max(moved_m, _length(step, 0) + reach * _length(step, 3))
        if every == 1 and floor < 2.0 * LEAST and moved_m < _STILL * size:
            return T, True, surfaces
        if every > 1 and moved_m < _CLOSE * size:
            every, floor = 1, LEAST
            some, weight, ranked = _every(every, points, trust, order)
            surfaces = unpaired(len(some))
        else:
            floor *= _SHRINK
    return T, False, surfaces


@compiled
def _every(k, points, trust, order):  # type: ignore[no-untyped-def]
    """Every k-th point with its weight, and their order by range."""
    ranked = np.empty((len(points) + k - 1) // k, np.int64)
    count = 0
    for row in order:
        if row % k == 0:
            ranked[count] = row // k
            count += 1
    return points[::k].copy(), trust[::k].copy(), ranked


@compiled
def _stepped(T, step):  # type: ignore[no-untyped-def]
    """A pose (4, 4) after a step (6,): shift of its position, turn about it, odom axes."""
    out, turn = T.copy(), rotation_of(step[3:])
    for i in range(3):
        out[i, 3] += step[i]
        for j in range(3):
            out[i, j] = turn[i, 0] * T[0, j] + turn[i, 1] * T[1, j] + turn[i, 2] * T[2, j]
    return out


@compiled
def _off(T, expected):  # type: ignore[no-untyped-def]
    """How far a pose is from another (6,): shift, and turn about the sensor, odom axes."""
    between, off = np.empty((3, 3)), np.empty(6)
    for i in range(3):
        for j in range(3):
            row, other = T[i], expected[j]
            between[i, j] = row[0] * other[0] + row[1] * other[1] + row[2] * other[2]
    turn = turn_of(between)
    for i in range(3):
        off[i], off[3 + i] = T[i, 3] - expected[i, 3], turn[i]
    return off


@compiled
def _length(values, first):  # type: ignore[no-untyped-def]
    """Length of three values in a row."""
    return np.sqrt(values[first] ** 2 + values[first + 1] ** 2 + values[first + 2] ** 2)


@compiled
def solve(H, b):  # type: ignore[no-untyped-def]
    """Solution of H step = -b in the directions that the points hold; zero along the others."""
    unit = units_of(H, 1e-12)
    values, vectors = np.linalg.eigh(scaled(H, unit, 0.0))
    step = np.zeros(len(b))
    for k in range(len(b)):
        if values[k] > 1e-4:
            along = 0.0
            for i in range(len(b)):
                along -= vectors[i, k] * b[i] / unit[i]
            for i in range(len(b)):
                step[i] += vectors[i, k] * along / values[k] / unit[i]
    return step


@compiled
def believed(H, b, any_way):  # type: ignore[no-untyped-def]
    """The part of a Gauss-Newton system that surfaces really hold.

    Normals are off a little everywhere, and alike over many points (bent depth images, planes
    fitted to noise): so one bare wall seems to hold the motion along it, by the weight of
    thousands of points. The gradient of that is taken as an error with covariance
    _LOOSE * (any_way - H), common to all points; where H is much larger, nothing changes.

    Args:
        H: (6, 6) information; b (6,) gradient.
        b: (6,).
        any_way: (6, 6) information if every surface held all directions.

    Returns:
        Information (6, 6) and gradient (6,); the solution of the system alone stays the same.
    """
    # Pairs of points are in H alone: where there are hardly any planes they set the units.
    unit = np.maximum(units_of(any_way, 1e-12), units_of(H, 1e-12))
    seeming, full = scaled(H, unit, 0.0), scaled(any_way, unit, 0.0)
    noise = seeming + _LOOSE * (full - seeming) + 1e-9 * np.eye(6)
    part = seeming @ np.linalg.inv(noise)
    return scaled(part @ seeming, 1.0 / unit, 0.0), (part @ (b / unit)) * unit


@compiled
def unheld(H, any_way):  # type: ignore[no-untyped-def]
    """Projection (6, 6) onto the directions that no surface holds; zero where all are held.

    Args:
        H: (6, 6) information of the planes.
        any_way: (6, 6) information if every surface held all directions.
    """
    unit = units_of(any_way, 1e-12)
    inverse = np.linalg.inv(np.linalg.cholesky(scaled(any_way, unit, 1e-6)))
    shares, vectors = np.linalg.eigh(inverse @ scaled(H, unit, 0.0) @ inverse.T)
    loose = inverse.T @ vectors
    projection = np.zeros((6, 6))
    for k in range(6):  # Gram-Schmidt
        if shares[k] >= _HELD:
            break
        axis = loose[:, k] / unit
        axis /= np.sqrt(axis @ axis)
        axis -= projection @ axis
        projection += np.outer(axis, axis) / (axis @ axis)
    return projection


@compiled
def assessed(points, trust, order, T, surfaces, size):  # type: ignore[no-untyped-def]
    """How well points sit in the map, with their surfaces.

    Args:
        points: (N, 3) float64, sensor frame, metres.
        trust: (N,) weights in [0, 1].
        order: (N,) rows of the points by range.
        T: (4, 4) the pose.
        surfaces: of the points, as paired at it.
        size: voxel edge, metres.

    Returns:
        Information (6, 6), overlap, cluster-robust covariance (6, 6) and `unheld` (6, 6), as in
        `Fit`.
    """
    measure(points, T, surfaces)
    planes, usable, paired = trust.copy(), 0, 0
    for row in range(len(points)):
        # Point-to-point pairs follow the sampling, not the world: they say nothing of the error.
        if surfaces.kind[row] != PLANE:
            planes[row] = 0.0
        if trust[row] > 0.5:
            usable += 1
            paired += surfaces.kind[row] != NONE
    scale = scales(surfaces, order, LEAST * size, size)
    H, b, any_way = normal_equations(
        points, planes, T, surfaces, scale, (POINT_SPREAD * size) ** 2
    )
    spread = cluster_covariance(points, planes, T, surfaces, scale, H, size)
    loose = unheld(H, any_way)
    return believed(H, b, any_way)[0], paired / max(1, usable), spread, loose
