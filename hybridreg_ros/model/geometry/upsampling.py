# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""From superpoints back to points: a value per superpoint spread over the input cloud."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.model.geometry.neighbours import CellList

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.geometry.pyramid import Pyramid

_SOFTENING_VOXELS = 0.5


@compiled
def _interpolate(
    points: NDArray[np.float32],
    superpoints: NDArray[np.float32],
    near: NDArray[np.int32],
    values: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Inverse-distance mean over the listed superpoints; the nearest of all where none is."""
    s = superpoints.shape[0]
    out = np.empty((points.shape[0], values.shape[1]), np.float32)
    total = np.empty(values.shape[1])
    for i in range(points.shape[0]):
        total[:] = 0.0
        weight = 0.0
        nearest, least = 0, np.inf
        lonely = near[i, 0] >= s
        for k in range(s if lonely else near.shape[1]):
            j = k if lonely else near[i, k]
            if j >= s:
                break
            d2 = 0.0
            for a in range(3):
                d2 += (points[i, a] - superpoints[j, a]) ** 2
            if d2 < least:
                nearest, least = j, d2
            w = 1.0 / (np.sqrt(d2) + _SOFTENING_VOXELS)
            for v in range(values.shape[1]):
                total[v] += w * values[j, v]
            weight += w
        for v in range(values.shape[1]):
            out[i, v] = values[nearest, v] if lonely else total[v] / weight
    return out


def upsample_to_level0(
    pyramid: Pyramid, values: NDArray[np.float32], rows: NDArray[np.int64] | None = None
) -> NDArray[np.float32]:
    """Interpolate values of the superpoints to every finest point, or to those listed.

    Each takes the mean of its three nearest superpoints, weighted by inverse distance; one that
    is far from all takes the value of the nearest.

    Args:
        pyramid: the cloud.
        values: (S,) or (S, V) float32.
        rows: (K,) finest points; None: all N0.

    Returns:
        (N0,) or (K,) float32; with V columns where `values` has them.
    """
    points, super_ = pyramid.levels[0].points, pyramid.superpoints
    points = points if rows is None else points[rows]
    reach = 2.0 * 2 ** (len(pyramid.levels) - 1)
    near = CellList.build(super_, reach).search(points, reach, 3)
    columns = np.ascontiguousarray(values.reshape(len(super_), -1), np.float32)
    spread: NDArray[np.float32] = _interpolate(points, super_, near, columns)
    return spread[:, 0] if values.ndim == 1 else spread


def values_of_inputs(
    pyramid: Pyramid, level0: NDArray[np.float32], missing: float = 1.0
) -> NDArray[np.float32]:
    """The value (N,) of every input point: that of its finest point, or `missing` for NaN rows."""
    found: NDArray[np.float32] = np.append(level0, np.float32(missing))[pyramid.input_to_level0]
    return found
