# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What decides between poses: how clouds meet, what is in the way, what the mask trusts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.jit import compiled
from hybridreg_ros.model.geometry.grid import cell_point, cosine, moved
from hybridreg_ros.model.geometry.upsampling import upsample_to_level0
from hybridreg_ros.model.geometry.views import View, depth_behind
from hybridreg_ros.model.network.estimators import weighted_inliers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.encoded import EncodedCloud
    from hybridreg_ros.model.geometry.grid import Space
    from hybridreg_ros.model.geometry.pyramid import Pyramid
    from hybridreg_ros.model.network.matching import MatchOutput
    from hybridreg_ros.model.pose.hypotheses import Candidates

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

FIT_RADIUS, _TIGHT_RADIUS = 1.5, 0.75
AGREEMENT_RADIUS = 2.5
MARGIN_VOXELS, MARGIN_SHARE = 3.0, 0.03

TRACES = (
    'fit',
    'tight',
    'trusted',
    'agreement',
    'intrusion',
    'visible',
    'hold',
    'contact',
)
"""Columns of `traces`:

* fit, tight: how the clouds lie on each other, within 1.5 and 0.75 voxels;
* trusted: the tight fit, points weighted by the mask;
* agreement: share of the descriptor matches that agree, weighted by their likelihood;
* intrusion: share of what stands still that lies in space the other sensor looked through;
* visible: share of what stands still that the other sensor should see;
* hold: smallest eigenvalue of the translational information of the contact, 0 = it can slide;
* contact: log(1 + number of points in contact).
"""

WEIGHTS = np.array([-2.72, 9.03, 54.40, 10.33, -137.60, -31.30, 9.66, 2.15])
"""Log-odds per trace, by `scripts/fit_score.py` (docs/lab, 2026-11-22)."""

UNMASKED_WEIGHTS = np.array([-12.88, 31.08, 31.08, 12.17, -55.01, -37.58, 8.12, 3.79])
"""The same where there is no mask, by `scripts/fit_score.py --no-mask`."""


@dataclass(frozen=True, eq=False)
class Opinion:
    """What the mask says of the points of a view that are tested, its `sample`.

    Attributes:
        trust: (K,) float32 P(static and seen by the other cloud).
        static: (K,) float32 P(static).
    """

    trust: F32
    static: F32

    @classmethod
    def of(cls, view: View, pyramid: Pyramid, sigma2: F32, static: F32) -> Opinion:
        """Spread what the mask says of the superpoints (S,) of a cloud over its view's sample."""
        both = upsample_to_level0(pyramid, np.column_stack([1.0 - sigma2, static]), view.rows)
        return cls(*np.ascontiguousarray(both.T))

    @classmethod
    def none(cls, view: View) -> Opinion:
        """All points count the same: without a mask."""
        ones = np.ones(len(view.sample), np.float32)
        return cls(ones, ones)


def opinions_of(
    source: EncodedCloud, target: EncodedCloud, found: MatchOutput
) -> tuple[Opinion, Opinion]:
    """What the mask says of the points of both clouds by which poses are judged."""
    return (
        Opinion.of(source.view, source.encoding.pyramid, found.source_sigma2, found.source_static),
        Opinion.of(target.view, target.encoding.pyramid, found.target_sigma2, found.target_static),
    )


@compiled
def _meeting(
    T: F64,
    sample: F32,
    sample_normals: F32,
    trust: F32,
    points: F32,
    normals: F32,
    space: Space,
) -> tuple[float, float, float, float, F64]:
    """Fit, tight fit, trusted tight fit, weight of the contact, and its normals' moments (3, 3).

    A point counts (1 - (distance / radius)^2) cos^2 of the angle between the normals.
    """
    fit = tight = trusted = total = contact = 0.0
    moments = np.zeros((3, 3))
    for i in range(sample.shape[0]):
        total += trust[i]
        x, y, z = moved(T, sample[i, 0], sample[i, 1], sample[i, 2])
        j = cell_point(x, y, z, space)
        if j < 0:
            continue
        d2 = (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2 + (points[j, 2] - z) ** 2
        if d2 >= FIT_RADIUS**2:
            continue
        near, square = 1.0 - d2 / FIT_RADIUS**2, cosine(T, sample_normals, i, normals, j) ** 2
        fit += near * square
        close = max(1.0 - d2 / _TIGHT_RADIUS**2, 0.0) * square
        tight += close
        trusted += trust[i] * close
        contact += near * near
        for k in range(3):
            for m in range(3):
                moments[k, m] += near * near * normals[j, k] * normals[j, m]
    count = max(sample.shape[0], 1)
    return fit / count, tight / count, trusted / max(total, 1e-9), contact, moments


@compiled
def _sight(
    sample: F32, static: F32, T: F64, sensor: F64, image: F32, near: F32
) -> tuple[float, float]:
    """Share of a sample in space that the other sensor looked through, and that it should see."""
    intruding = visible = total = 0.0
    for i in range(sample.shape[0]):
        total += static[i]
        x, y, z = moved(T, sample[i, 0], sample[i, 1], sample[i, 2])
        behind, reach = depth_behind(x, y, z, sensor, image, near)
        if np.isinf(reach):
            continue
        margin = MARGIN_VOXELS + MARGIN_SHARE * reach
        if behind < -margin:
            intruding += static[i]
        if behind < margin:
            visible += static[i]
    total = max(total, 1e-9)
    return intruding / total, visible / total


def traces(
    T: F64, matches: Candidates, views: tuple[View, View], opinions: tuple[Opinion, Opinion]
) -> F64:
    """What speaks for and against poses.

    Args:
        T: (B, 4, 4) transforms source to target, voxels.
        matches: descriptor matches of fine points, voxels.
        views: source and target.
        opinions: of the mask, of both.

    Returns:
        (B, 8), columns as in `TRACES`; all but `agreement` are the mean of both ways.
    """
    share = weighted_inliers(
        T, matches.source, matches.target, matches.weights, AGREEMENT_RADIUS
    ) / max(float(matches.weights.sum()), 1e-9)
    out = np.empty((len(T), len(TRACES)))
    for b, forward in enumerate(T):
        there = _one_way(forward, *_sides(*views, opinions[0]))
        back = _one_way(se3.inverse(forward), *_sides(*views[::-1], opinions[1]))
        fit, tight, trusted, intrusion, visible, hold, contact = 0.5 * (there + back)
        out[b] = fit, tight, trusted, share[b], intrusion, visible, hold, contact
    return out


def _sides(moving: View, fixed: View, opinion: Opinion) -> tuple[Any, ...]:
    """What `_one_way` takes of two clouds."""
    points = moving.sample, moving.sample_normals, opinion.trust, opinion.static
    return (
        points,
        (fixed.points, fixed.normals, fixed.grid.space),
        (
            fixed.sensor,
            fixed.image,
            fixed.near,
        ),
    )


@compiled
def _one_way(T: F64, moving: Any, fixed: Any, seen: Any) -> F64:
    """Traces (7,) of one cloud laid on the other; all but the agreement."""
    sample, normals, trust, static = moving
    fit, tight, trusted, contact, moments = _meeting(T, sample, normals, trust, *fixed)
    intrusion, visible = _sight(sample, static, T, *seen)
    hold = np.linalg.eigvalsh(moments)[0] / max(contact, 1e-9)
    return np.array([fit, tight, trusted, intrusion, visible, hold, np.log1p(contact)])


def scores(found: F64, masked: bool = True) -> F64:
    """Log-odds (B,) of poses, up to a constant, from their traces (B, 8).

    `masked`: whether the traces were made with the opinions of a mask.
    """
    decided: F64 = found @ (WEIGHTS if masked else UNMASKED_WEIGHTS)
    return decided
