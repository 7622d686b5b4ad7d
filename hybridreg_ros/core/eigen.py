# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Smallest principal axis of a symmetric 3x3 matrix in closed form, for compiled loops."""

from __future__ import annotations

import numpy as np

from hybridreg_ros.core.jit import compiled


@compiled
def smallest_axis(xx, xy, xz, yy, yz, zz):  # type: ignore[no-untyped-def]
    """Eigenvalues (ascending) and unit eigenvector of the smallest, of a symmetric 3x3 matrix.

    Returns:
        (l0, l1, l2, nx, ny, nz); the vector is zero when the matrix is a multiple of the identity.
    """
    off = xy * xy + xz * xz + yz * yz
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    p = np.sqrt((a * a + b * b + c * c + 2.0 * off) / 6.0)
    if p < 1e-15:
        return mean, mean, mean, 0.0, 0.0, 0.0
    det = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    half = min(1.0, max(-1.0, det / (2.0 * p * p * p)))
    phi = np.arccos(half) / 3.0
    l2 = mean + 2.0 * p * np.cos(phi)
    l0 = mean + 2.0 * p * np.cos(phi + 2.0943951023931953)
    l1 = 3.0 * mean - l0 - l2
    best, nx, ny, nz = 0.0, 0.0, 0.0, 0.0
    r00, r11, r22 = xx - l0, yy - l0, zz - l0
    # The rows of A - l0 I span the plane across the eigenvector: take their longest product.
    cx, cy, cz = xy * yz - xz * r11, xz * xy - r00 * yz, r00 * r11 - xy * xy
    norm = cx * cx + cy * cy + cz * cz
    if norm > best:
        best, nx, ny, nz = norm, cx, cy, cz
    cx, cy, cz = xy * r22 - xz * yz, xz * xz - r00 * r22, r00 * yz - xy * xz
    norm = cx * cx + cy * cy + cz * cz
    if norm > best:
        best, nx, ny, nz = norm, cx, cy, cz
    cx, cy, cz = r11 * r22 - yz * yz, yz * xz - xy * r22, xy * yz - r11 * xz
    norm = cx * cx + cy * cy + cz * cz
    if norm > best:
        best, nx, ny, nz = norm, cx, cy, cz
    if best > 0.0:
        scale = 1.0 / np.sqrt(best)
        nx, ny, nz = nx * scale, ny * scale, nz * scale
    return l0, l1, l2, nx, ny, nz
