# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels of robust point-to-plane ICP against a voxel level."""

from __future__ import annotations

import numpy as np

from hybridreg_ros.core.jit import compiled, compiled_inline
from hybridreg_ros.odometry.map.planes import buffer, fit_around
from hybridreg_ros.odometry.map.voxel_map import nearest

NONE, POINT, PLANE = 0, 1, 2
GRAZING = 0.12
"""A surface is not seen edge-on (cosine between normal and beam). Of a single ring of a lidar the
range noise makes a strip, and that lies in the cone of its beams: it would travel along with the
sensor and hold it where it was."""
SAME_PLANE = 1.0
"""Standard deviations of the points about a plane within which another of its voxel lies on it."""
BETWEEN = 0.5
"""How far off a surface of the wider level a point between the rings may be, in voxels."""


@compiled
def fit_surface(i, grid, wider, widest, update, room):  # type: ignore[no-untyped-def]
    """Fit the surface of one stored point, on its own level or on the next that shows one."""
    x, y, z = grid.store[i, 0], grid.store[i, 1], grid.store[i, 2]
    beam = grid.beam[i]
    n, nx, ny, nz, offset, variance = fit_around(x, y, z, grid, room)
    if n == 0 or _edge_on(nx, ny, nz, beam):
        n, nx, ny, nz, offset, variance = fit_around(x, y, z, wider, room)
        if n == 0 and widest.size > wider.size:
            n, nx, ny, nz, offset, variance = fit_around(x, y, z, widest, room)
        if _edge_on(nx, ny, nz, beam):
            n = 0
    surface = grid.surface[i]
    surface.nx, surface.ny, surface.nz = nx, ny, nz
    surface.offset, surface.variance = offset, variance
    surface.fitted, surface.support = update, n


@compiled_inline
def _edge_on(nx, ny, nz, beam):  # type: ignore[no-untyped-def]
    """Whether a surface with this normal was seen too edge-on to be one; true without a normal."""
    return abs(nx * beam[0] + ny * beam[1] + nz * beam[2]) < GRAZING


@compiled_inline
def _lasts(support):  # type: ignore[no-untyped-def]
    """Updates of the map for which a surface stays as it is; 0 while there is none yet."""
    if support == 0:
        return 0
    return 24 if support > 20 else 6


@compiled
def _nearest_each(points, T, grid):  # type: ignore[no-untyped-def]
    """Stored point nearest to each moved point and its voxel, (N,) int64; -1 = none."""
    at, home = np.empty(len(points), np.int64), np.empty(len(points), np.int64)
    for row in range(len(points)):
        x, y, z = moved(points, row, T)
        at[row], home[row], _ = nearest(x, y, z, grid)
    return at, home


@compiled_inline
def moved(points, row, T):  # type: ignore[no-untyped-def]
    """Point of a row, in the map frame."""
    px, py, pz = points[row, 0], points[row, 1], points[row, 2]
    x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
    y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
    z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
    return x, y, z


@compiled
def _fit_due(at, home, grid, wider, widest, update):  # type: ignore[no-untyped-def]
    """Fit the surfaces of the stored points `at` (N,), in voxels `home`, that are due."""
    room = buffer(grid)
    for row in range(len(at)):
        i = at[row]
        if i >= 0 and _is_due(grid.surface[i], update) and not _shares(i, home[row], grid, update):
            fit_surface(i, grid, wider, widest, update, room)


@compiled_inline
def _is_due(surface, update):  # type: ignore[no-untyped-def]
    """Whether a surface must be fitted anew."""
    return surface.fitted == 0 or update - surface.fitted > _lasts(surface.support)


@compiled
def _shares(i, voxel, grid, update):  # type: ignore[no-untyped-def]
    """Let stored point i have the plane of another one of its voxel, if it lies on one.

    Not in the map of a lidar: planes fitted to few rings would be handed on.
    """
    if not grid.by_mass:
        return False
    start = grid.voxels[voxel].start
    for k in range(start, start + grid.voxels[voxel].count):
        other = grid.surface[k]
        if other.support == 0 or _is_due(other, update):
            continue
        off = other.offset
        off -= other.nx * (grid.store[i, 0] - grid.store[k, 0])
        off -= other.ny * (grid.store[i, 1] - grid.store[k, 1])
        off -= other.nz * (grid.store[i, 2] - grid.store[k, 2])
        if off * off <= SAME_PLANE * SAME_PLANE * other.variance:
            own = grid.surface[i]
            own.nx, own.ny, own.nz, own.offset = other.nx, other.ny, other.nz, off
            own.variance, own.fitted, own.support = other.variance, other.fitted, other.support
            return True
    return False


@compiled
def associate(points, T, grids, update, surfaces):  # type: ignore[no-untyped-def]
    """Surface of the map nearest to each moved point, into `surfaces`.

    The nearest stored point within one voxel edge brings its surface along. It is fitted when
    first needed and again after some updates of the map, so it does not follow the query point:
    a surface fitted around the query would creep along with it and slow the convergence down.

    Where a lidar has few rings, a point that falls between old ones has no stored point so near.
    If only those that happen to fall on old rings counted, the sensor would be held where rings
    meet rings. So such a point is paired on the wider level, when it lies on a plane there.

    Args:
        points: (N, 3) float64, sensor frame.
        T: (4, 4) moves them into the map frame.
        grids: the level; the wider one that gives surfaces where this one is too fine; the widest
            one that does where that one is too fine as well (the wider one again for none).
        update: number of updates of the map so far, > 0.
        surfaces: N of them.
    """
    grid, wider, widest = grids
    at, home = _nearest_each(points, T, grid)
    _fit_due(at, home, grid, wider, widest, update)
    _pair(points, np.arange(len(points)), at, T, np.inf, grid, surfaces)
    if wider.size > grid.size and not grid.by_mass:
        left = np.flatnonzero(at < 0)
        at, home = _nearest_each(points[left], T, wider)
        _fit_due(at, home, wider, widest, widest, update)
        _pair(points, left, at, T, BETWEEN * grid.size, wider, surfaces)


@compiled
def _pair(points, rows, at, T, slack, grid, surfaces):  # type: ignore[no-untyped-def]
    """Pair points `rows` with the surfaces of stored points `at`.

    With a finite slack only those that are planes no farther away, metres.
    """
    kind, anchor, normal, var, born, _ = surfaces
    for k in range(len(rows)):
        row, i = rows[k], at[k]
        kind[row] = NONE
        if i < 0:
            continue
        surface = grid.surface[i]
        if slack < np.inf:
            x, y, z = moved(points, row, T)
            off = -float(surface.offset)
            off += (x - grid.store[i, 0]) * surface.nx
            off += (y - grid.store[i, 1]) * surface.ny
            off += (z - grid.store[i, 2]) * surface.nz
            if surface.support == 0 or abs(off) >= slack:
                continue
        kind[row] = PLANE if surface.support > 0 else POINT
        born[row], var[row] = surface.born, surface.variance
        normal[row, 0], normal[row, 1], normal[row, 2] = surface.nx, surface.ny, surface.nz
        for axis in range(3):
            anchor[row, axis] = grid.store[i, axis] + surface.offset * normal[row, axis]


@compiled
def measure(points, T, surfaces):  # type: ignore[no-untyped-def]
    """Distance of each moved point to its plane or point, metres, into `surfaces`; inf = none."""
    kind, anchor, normal, _, _, out = surfaces
    for row in range(len(points)):
        if kind[row] == NONE:
            out[row] = np.inf
            continue
        x, y, z = moved(points, row, T)
        dx, dy, dz = x - anchor[row, 0], y - anchor[row, 1], z - anchor[row, 2]
        if kind[row] == PLANE:
            out[row] = abs(dx * normal[row, 0] + dy * normal[row, 1] + dz * normal[row, 2])
        else:
            out[row] = np.sqrt(dx * dx + dy * dy + dz * dz)


@compiled
def _add_any(H, w, ax, ay, az):  # type: ignore[no-untyped-def]
    """Add to the upper half of H (6, 6) what holds a point in all three directions."""
    # J = [I, -hat(a)]
    H[0, 0] += w
    H[1, 1] += w
    H[2, 2] += w
    H[0, 4] += w * az
    H[0, 5] -= w * ay
    H[1, 3] -= w * az
    H[1, 5] += w * ax
    H[2, 3] += w * ay
    H[2, 4] -= w * ax
    H[3, 3] += w * (ay * ay + az * az)
    H[4, 4] += w * (ax * ax + az * az)
    H[5, 5] += w * (ax * ax + ay * ay)
    H[3, 4] -= w * ax * ay
    H[3, 5] -= w * ax * az
    H[4, 5] -= w * ay * az


@compiled
def units_of(H, least):  # type: ignore[no-untyped-def]
    """Units (N,) in which the diagonal of a matrix (N, N) is 1, or less where it is too small."""
    unit = np.empty(len(H))
    for i in range(len(H)):
        unit[i] = np.sqrt(max(H[i, i], least))
    return unit


@compiled
def scaled(H, unit, added):  # type: ignore[no-untyped-def]
    """A matrix (N, N) over units (N,) of rows and columns, its diagonal then raised by `added`."""
    out = np.empty(H.shape)
    for i in range(len(unit)):
        for j in range(len(unit)):
            out[i, j] = H[i, j] / (unit[i] * unit[j])
        out[i, i] += added
    return out


@compiled
def normal_equations(points, weights, T, surfaces, scale, point_var):  # type: ignore[no-untyped-def]
    """Gauss-Newton system of the robust cost at a pose.

    The unknowns are a shift (3,) of the position and a turn (3,) about the sensor, both in map
    axes. Each residual is weighted by its variance and by a Geman-McClure kernel.

    Args:
        points: (N, 3) float64, sensor frame.
        weights: (N,) share of trust per point, [0, 1].
        T: (4, 4) the pose.
        surfaces: of the points.
        scale: (N,) standard deviation of a good plane residual, metres.
        point_var: variance of a point-to-point residual, m^2.

    Returns:
        H (6, 6), b (6,): the step solves H step = -b. And G (6, 6): what H would be of the planes
        if their normals pointed everywhere evenly, times three.
    """
    kind, anchor, normal, var, _, _ = surfaces
    H = np.zeros((6, 6))
    G = np.zeros((6, 6))
    b = np.zeros(6)
    J = np.zeros(6)
    for row in range(len(points)):
        if kind[row] == NONE or weights[row] <= 0.0:
            continue
        x, y, z = moved(points, row, T)
        ax, ay, az = x - T[0, 3], y - T[1, 3], z - T[2, 3]
        dx, dy, dz = x - anchor[row, 0], y - anchor[row, 1], z - anchor[row, 2]
        if kind[row] == PLANE:
            nx, ny, nz = normal[row, 0], normal[row, 1], normal[row, 2]
            r = dx * nx + dy * ny + dz * nz
            variance = scale[row] * scale[row] + var[row]
            kernel = 9.0 * variance / (9.0 * variance + r * r)
            w = weights[row] * kernel * kernel / variance
            _add_any(G, w, ax, ay, az)
            J[0], J[1], J[2] = nx, ny, nz
            J[3], J[4], J[5] = ay * nz - az * ny, az * nx - ax * nz, ax * ny - ay * nx
            for i in range(6):
                b[i] += w * J[i] * r
                for j in range(i, 6):
                    H[i, j] += w * J[i] * J[j]
        else:
            d = dx * dx + dy * dy + dz * dz
            kernel = 9.0 * point_var / (9.0 * point_var + d)
            w = weights[row] * kernel * kernel / point_var
            _add_any(H, w, ax, ay, az)
            b[0] += w * dx
            b[1] += w * dy
            b[2] += w * dz
            b[3] += w * (ay * dz - az * dy)
            b[4] += w * (az * dx - ax * dz)
            b[5] += w * (ax * dy - ay * dx)
    for i in range(6):
        for j in range(i):
            H[i, j] = H[j, i]
            G[i, j] = G[j, i]
    return H, b, G
