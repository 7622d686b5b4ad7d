# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Are the labels of a pair right? Measured with its clouds, in sigmas of the sensor's noise.

Distances are those to the disc through the ten nearest points of the other cloud. Where these
ten points are no plane (leaves, kerbs, cloth), a distance says nothing about noise, so only points
are counted where they are thinner than the noise allows, and where both sensors stand on the same
side of that plane (else one saw the front of a trunk or a sign, and the other its back). A moving
thing whose motion is along its own surface, or smaller than the noise, cannot be told from a
static one by any measurement: moving points are counted where their true motion across the surface
exceeds six sigmas.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from hybridreg_ros.core.se3 import apply

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.hybridmatch.take import Sample

    F64 = NDArray[np.float64]

SIGMAS, MOVED_SIGMAS = 3.0, 6.0
FEWEST, FEWEST_TOLD = 30, 100
NEAR_M, STRAY_SIGMAS = 0.3, 10.0
NEIGHBOURS = 10


@dataclass(frozen=True)
class LabelCheck:
    """What one pair says; medians, in sigmas; NaN where fewer than 100 points can tell.

    Attributes:
        static: static points under the true transform, from the other cloud's static surface.
        static_points: number of points behind `static`.
        stray: share of these points that are off by more than ten sigmas.
        met: share of the static points of the overlap that have a counterpart.
        carried: moving points, carried by their own true motion, from the same thing's surface.
        left: the same points without that motion.
        judged: moving points behind `left`, as a share of those seen in both clouds.
    """

    static: float
    static_points: int
    stray: float
    met: float
    carried: float
    left: float
    judged: float


@dataclass(frozen=True)
class _Surface:
    away: F64
    off: F64
    normal: F64
    thickness: F64


def _surface(points: F64, others: NDArray[np.float32]) -> _Surface:
    """Distance of points (N, 3) to the nearest of others (M, 3), and to the disc of ten."""
    away, rows = cKDTree(others).query(points, NEIGHBOURS)
    patch = others[rows].astype(np.float64)
    centre = patch.mean(1)
    moment = np.einsum('nki,nkj->nij', patch - centre[:, None], patch - centre[:, None])
    value, vector = np.linalg.eigh(moment)
    normal = vector[:, :, 0]
    height = np.einsum('ni,ni->n', points - centre, normal)
    aside = np.linalg.norm(points - centre - height[:, None] * normal, axis=1)
    radius = np.linalg.norm(patch - centre[:, None], axis=2).max(1)
    off = np.hypot(height, np.maximum(aside - radius, 0.0))
    return _Surface(away[:, 0], off, normal, np.sqrt(np.maximum(value[:, 0], 0.0) / NEIGHBOURS))


def check_labels(sample: Sample) -> LabelCheck:
    """Measure one pair."""
    pair, T = sample.pair, sample.pair.T_target_source
    sigma = np.maximum(np.sqrt(2.0) * sample.truth.sigma_m.astype(np.float64), 0.001)
    there = apply(T, pair.source.astype(np.float64))
    still = np.flatnonzero(pair.source_label == 0)
    found = _surface(there[still], pair.target[pair.target_label == 0])
    near = (found.away < NEAR_M) & sample.truth.seen[still]
    side = [np.einsum('ni,ni->n', found.normal, eye - there[still]) for eye in (0.0, T[:3, 3])]
    clear = near & (found.thickness < SIGMAS * sigma[still]) & (side[0] * side[1] > 0.0)
    ratio = found.off[clear] / sigma[still][clear]
    carried, left, seen = _moving(sample, there, sigma)
    return LabelCheck(
        _median(ratio),
        len(ratio),
        float((ratio > STRAY_SIGMAS).sum()) / max(len(ratio), 1),
        float(near.sum()) / max(int(sample.truth.seen.sum()), 1),
        _median(carried),
        _median(left),
        len(left) / max(seen, 1),
    )


def _moving(sample: Sample, there: F64, sigma: F64) -> tuple[F64, F64, int]:
    """Ratios with and without the true motion of all points that can tell, and how many may."""
    pair = sample.pair
    if not pair.source_label.any():
        return np.zeros(0), np.zeros(0), 0
    flow = sample.truth.flow(pair) @ pair.T_target_source[:3, :3].T
    carried, left, seen = [], [], 0
    for number in np.unique(pair.source_instance[pair.source_label > 0]):
        mine = np.flatnonzero(pair.source_instance == number)
        other = pair.target[pair.target_instance == number]
        if len(mine) < FEWEST or len(other) < FEWEST:
            continue
        after = _surface(there[mine] + flow[mine], other)
        found = (after.away < pair.voxel_size_m) & (after.thickness < SIGMAS * sigma[mine])
        across = np.abs(np.einsum('ni,ni->n', flow[mine], after.normal))
        told = found & (across > MOVED_SIGMAS * sigma[mine])
        seen += int(found.sum())
        if told.any():
            before = _surface(there[mine[told]], other)
            carried.append(after.off[told] / sigma[mine[told]])
            left.append(before.off / sigma[mine[told]])
    if not left:
        return np.zeros(0), np.zeros(0), seen
    return np.concatenate(carried), np.concatenate(left), seen


def _median(values: F64) -> float:
    return float(np.median(values)) if len(values) >= FEWEST_TOLD else float('nan')
