# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Smallest principal axis of a symmetric 3x3 matrix in closed form, for compiled loops."""

from __future__ import annotations

import numpy as np

from hybridreg_ros.core.jit import compiled_into


@compiled_into
def smallest_axis(xx, xy, xz, yy, yz, zz):  # type: ignore[no-untyped-def]
    """Eigenvalues (ascending) and unit eigenvector of the smallest, of a symmetric 3x3 matrix.

    Without a branch or a call, so that a loop of it fits vector registers.

    Returns:
        (l0, l1, l2, nx, ny, nz); the vector is zero when the matrix is a multiple of the identity.
    """
    off = xy * xy + xz * xz + yz * yz
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    p = np.sqrt((a * a + b * b + c * c + 2.0 * off) / 6.0)
    det = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    half = min(1.0, max(-1.0, det / max(2.0 * p * p * p, 1e-300)))
    # Of x^3 - 3 x - 2 half = 0 the largest root is 2 cos(arccos(half) / 3): both by series, to
    # 1e-7 (Abramowitz and Stegun, 4.4.46), then a step of Newton's; the others follow from it.
    g = abs(half)
    turn = 0.0308918810 + g * (-0.0170881256 + g * (0.0066700901 - g * 0.0012624911))
    turn = 0.0889789874 + g * (-0.0501743046 + g * turn)
    turn = np.sqrt(1.0 - g) * (1.5707963050 + g * (-0.2145988016 + g * turn))
    turn = (turn if half >= 0.0 else np.pi - turn) / 3.0
    q = turn * turn
    x = 2.0 + q * (-1.0 + q * (1 / 12 + q * (-1 / 360 + q * (1 / 20160 - q / 1814400))))
    x -= (x * (x * x - 3.0) - 2.0 * half) / max(3.0 * x * x - 3.0, 1e-9)
    l0 = mean - 0.5 * p * (x + np.sqrt(max(0.0, 12.0 - 3.0 * x * x)))
    l2 = mean + p * x
    # The rows of A - l0 I span the plane across the eigenvector: take their longest product.
    r00, r11, r22 = xx - l0, yy - l0, zz - l0
    nx, ny, nz = xy * yz - xz * r11, xz * xy - r00 * yz, r00 * r11 - xy * xy
    best = nx * nx + ny * ny + nz * nz
    cx, cy, cz = xy * r22 - xz * yz, xz * xz - r00 * r22, r00 * yz - xy * xz
    norm = cx * cx + cy * cy + cz * cz
    longer = norm > best
    nx, ny, nz = cx if longer else nx, cy if longer else ny, cz if longer else nz
    best = max(best, norm)
    cx, cy, cz = r11 * r22 - yz * yz, yz * xz - xy * r22, xy * yz - r11 * xz
    norm = cx * cx + cy * cy + cz * cz
    longer = norm > best
    nx, ny, nz = cx if longer else nx, cy if longer else ny, cz if longer else nz
    scale = 0.0 if p < 1e-15 else 1.0 / np.sqrt(max(best, norm, 1e-300))
    return l0, 3.0 * mean - l0 - l2, l2, nx * scale, ny * scale, nz * scale
