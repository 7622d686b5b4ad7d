# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the network says of a pose: the fit of the points it trusts, and the features that meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.jit import compiled
from hybridreg_ros.model.geometry.grid import cell_point, cosine, moved
from hybridreg_ros.model.geometry.upsampling import upsample_to_level0
from hybridreg_ros.model.network.forward_attention import unit_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.encoded import EncodedCloud
    from hybridreg_ros.model.geometry.grid import Space
    from hybridreg_ros.model.geometry.views import View
    from hybridreg_ros.model.network.matching import MatchOutput
    from hybridreg_ros.model.network.output import Encoding

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    I64 = NDArray[np.int64]
    Side = tuple[F32, I64, F32]

_CERTAIN_AFTER = 10.0
"""Meeting points after which their mean similarity counts half."""


@dataclass(frozen=True, eq=False)
class CloudEvidence:
    """What the network knows of the points of a cloud when it has seen the other.

    Attributes:
        sigma2: (N,) float32 of every finest point, P(moving, or not seen by the other cloud).
        owner: (N,) int64 fine point that holds each finest point.
        features: (F, C) float32 unit features of the fine points.
    """

    sigma2: F32
    owner: I64
    features: F32

    @classmethod
    def of(cls, encoding: Encoding[F32], sigma2: F32) -> CloudEvidence:
        """The evidence of an encoded cloud; sigma2: (S,) float32 of every superpoint."""
        pyramid = encoding.pyramid
        owner = np.arange(len(pyramid.levels[0].points))
        for level in pyramid.levels[: pyramid.fine_level]:
            assert level.up_index is not None
            owner = level.up_index[owner]
        return cls(upsample_to_level0(pyramid, sigma2), owner, unit_rows(encoding.fine_features))

    @property
    def side(self) -> Side:
        """The evidence as compiled functions take it."""
        return np.float32(1.0) - self.sigma2, self.owner, self.features


def evidence_of(
    source: EncodedCloud, target: EncodedCloud, found: MatchOutput
) -> tuple[CloudEvidence, CloudEvidence]:
    """What the network knows of the points of both clouds."""
    return (
        CloudEvidence.of(source.encoding, found.source_sigma2),
        CloudEvidence.of(target.encoding, found.target_sigma2),
    )


@compiled
def _alike(a: F32, b: F32) -> float:
    """Dot product of two rows, in eight sums that fit a vector register."""
    sums = np.zeros(8, np.float32)
    for c in range(0, a.shape[0] - 7, 8):
        for k in range(8):
            sums[k] += a[c + k] * b[c + k]
    total = 0.0
    for k in range(8):
        total += sums[k]
    for c in range(a.shape[0] - a.shape[0] % 8, a.shape[0]):
        total += a[c] * b[c]
    return total


@compiled
def _one_way(
    T: F64,
    rows: I64,
    moving: tuple[F32, F32],
    own: Side,
    fixed: tuple[F32, F32],
    other: Side,
    space: Space,
    r2: float,
) -> tuple[float, float]:
    """Trusted fit and mean similarity of the listed points of one cloud on the other."""
    weight = total = alike = 0.0
    met = _CERTAIN_AFTER
    for r in rows:
        trust = own[0][r]
        weight += trust
        x, y, z = moved(T, moving[0][r, 0], moving[0][r, 1], moving[0][r, 2])
        j = cell_point(x, y, z, space)
        if j < 0:
            continue
        d2 = (fixed[0][j, 0] - x) ** 2 + (fixed[0][j, 1] - y) ** 2 + (fixed[0][j, 2] - z) ** 2
        if d2 >= r2:
            continue
        square = cosine(T, moving[1], r, fixed[1], j) ** 2
        total += trust * (1.0 - d2 / r2) * square
        alike += _alike(own[2][own[1][r]], other[2][other[1][j]])
        met += 1.0
    return total / max(weight, 1e-9), alike / met


def trusted_fit(
    T: F64,
    views: tuple[View, View],
    evidence: tuple[CloudEvidence, CloudEvidence],
    radius: float = 1.5,
) -> tuple[float, float]:
    """How the trusted points of two clouds lie on each other, and how alike what meets is.

    Args:
        T: (4, 4) transform source to target, voxels.
        views: source and target.
        evidence: of both.
        radius: farther points do not meet, voxels.

    Returns:
        Fit in [0, 1]: mean over both ways of (1 - (d / radius)^2) cos^2 of the angle between the
        normals, each point weighted by its trust; and resemblance in [-1, 1]: mean cosine
        similarity of the features of the points that meet, towards 0 for few of them.
    """
    (a, b), (e, f) = views, evidence
    one, other = (a.points, a.normals), (b.points, b.normals)
    r2, inverse = radius * radius, se3.inverse(T)
    there = _one_way(T, a.rows, one, e.side, other, f.side, b.grid.space, r2)
    back = _one_way(inverse, b.rows, other, f.side, one, e.side, a.grid.space, r2)
    return 0.5 * (there[0] + back[0]), 0.5 * (there[1] + back[1])
