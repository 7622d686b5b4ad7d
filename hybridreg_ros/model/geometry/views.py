# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What a cloud shows and what it rules out: nearest surface per cell, and free space."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.core.se3 import inverse_of
from hybridreg_ros.model.geometry.grid import Grid, cell_point, cosine, moved

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.geometry.grid import Space

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    I32 = NDArray[np.int32]
    I64 = NDArray[np.int64]

_CELL_VOXELS = 1.0
_WIDE_CELL_VOXELS = 2.5
_FACE_BINS = 45
SAMPLE = 640
"""Points of a cloud that are tested against the other."""


@compiled
def direction_bin(x: float, y: float, z: float, bins: int) -> tuple[int, int, int]:
    """Face of a cube around the sensor, and row and column on it."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face, u, v, w = (0 if x > 0 else 1), y, z, ax
    elif ay >= az:
        face, u, v, w = (2 if y > 0 else 3), x, z, ay
    else:
        face, u, v, w = (4 if z > 0 else 5), x, y, az
    w = max(w, 1e-9)
    row = min(int((u / w + 1.0) * 0.5 * bins), bins - 1)
    column = min(int((v / w + 1.0) * 0.5 * bins), bins - 1)
    return face, row, column


@compiled
def depth_behind(
    x: float, y: float, z: float, sensor: F64, image: F32, near: F32
) -> tuple[float, float]:
    """How far a place lies behind what a sensor (3,) saw in its direction, and how far that was.

    In the unit of the range images (6, B, B) of a `View`; negative = before it, in space that was
    looked through. The range is inf where nothing was seen.
    """
    x, y, z = x - sensor[0], y - sensor[1], z - sensor[2]
    face, row, column = direction_bin(x, y, z, image.shape[1])
    if np.isinf(image[face, row, column]):
        return 0.0, np.inf
    reach = near[face, row, column]
    return np.sqrt(x * x + y * y + z * z) - reach, reach


@compiled
def _range_image(points: F32, sensor: F64, bins: int) -> tuple[F32, F32]:
    """Nearest range per direction, and the same with the smallest of its neighbours; inf: none."""
    image = np.full((6, bins, bins), np.inf, np.float32)
    for i in range(points.shape[0]):
        x, y, z = points[i, 0] - sensor[0], points[i, 1] - sensor[1], points[i, 2] - sensor[2]
        face, row, column = direction_bin(x, y, z, bins)
        r = np.sqrt(x * x + y * y + z * z)
        image[face, row, column] = min(image[face, row, column], r)
    near = image.copy()
    for f in range(6):
        for r in range(bins):
            for c in range(bins):
                for i in range(max(r - 1, 0), min(r + 2, bins)):
                    for j in range(max(c - 1, 0), min(c + 2, bins)):
                        near[f, r, c] = min(near[f, r, c], image[f, i, j])
    return image, near


@dataclass(frozen=True, eq=False)
class View:
    """A cloud prepared for judging poses.

    Attributes:
        points: (N, 3) float32, voxels.
        normals: (N, 3) float32 unit.
        rows: (K,) int64 numbers of the points that are tested against the other cloud.
        sample: (K, 3) float32, those points.
        sample_normals: (K, 3) float32 unit.
        grid: of cells of one voxel.
        wide: of larger cells.
        sensor: (3,) float64 position of the sensor, voxels.
        image: (6, B, B) float32 nearest range per direction, voxels; inf where nothing was seen.
        near: the same, the smallest of each direction's neighbourhood.
    """

    points: F32
    normals: F32
    rows: I64
    sample: F32
    sample_normals: F32
    grid: Grid
    wide: Grid
    sensor: F64
    image: F32
    near: F32

    @classmethod
    def build(cls, points: F32, normals: F32, sensor: F64, sample: int = SAMPLE) -> View:
        """Prepare a cloud.

        Args:
            points: (N, 3) voxels, N >= 1.
            normals: (N, 3) unit.
            sensor: (3,) where the sensor was, voxels.
            sample: number of points to test, evenly spread over the order of `points`.
        """
        rows = _evenly_spread(len(points), sample)
        grids = Grid.build(points, _CELL_VOXELS), Grid.build(points, _WIDE_CELL_VOXELS)
        image, near = _range_image(points, sensor, _FACE_BINS)
        return cls(points, normals, rows, points[rows], normals[rows], *grids, sensor, image, near)

    def resampled(self, most: int) -> View:
        """The same view with up to `most` points to test, evenly spread over all."""
        rows = _evenly_spread(len(self.points), most)
        if len(rows) == len(self.points):
            return dataclasses.replace(
                self, rows=rows, sample=self.points, sample_normals=self.normals
            )
        return dataclasses.replace(
            self, rows=rows, sample=self.points[rows], sample_normals=self.normals[rows]
        )

    def thinned(self, every: int) -> View:
        """The same view with one in `every` of its sampled points."""
        return dataclasses.replace(
            self,
            rows=np.ascontiguousarray(self.rows[::every]),
            sample=np.ascontiguousarray(self.sample[::every]),
            sample_normals=np.ascontiguousarray(self.sample_normals[::every]),
        )


def _evenly_spread(count: int, most: int) -> I64:
    """At most `most` of the numbers 0 to count - 1, ascending."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).astype(np.int64)


@compiled
def _inverses(T: F64) -> F64:
    """Inverse of each of B rigid transforms (B, 4, 4)."""
    out = np.empty_like(T)
    for b in range(T.shape[0]):
        out[b] = inverse_of(T[b])
    return out


@compiled
def _fits(
    poses: F64,
    sample: F32,
    sample_normals: F32,
    points: F32,
    normals: F32,
    space: Space,
    r2: float,
) -> F64:
    """Mean over the sample of how well each point lies on the surface, (B,) in [0, 1].

    (1 - (distance / radius)^2) cos^2 of the angle between the normals, 0 beyond the radius.
    """
    out = np.zeros(poses.shape[0])
    for b in range(poses.shape[0]):
        T = poses[b]
        for i in range(sample.shape[0]):
            x, y, z = moved(T, sample[i, 0], sample[i, 1], sample[i, 2])
            j = cell_point(x, y, z, space)
            if j < 0:
                continue
            d2 = (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2 + (points[j, 2] - z) ** 2
            if d2 < r2:
                out[b] += (1.0 - d2 / r2) * cosine(T, sample_normals, i, normals, j) ** 2
    out /= max(sample.shape[0], 1)
    return out


@compiled
def _intrusions(
    poses: F64, sample: F32, sensor: F64, image: F32, near: F32, margin: float, share: float
) -> F64:
    """Share of the sample that would stand in space the other sensor looked through, (B,)."""
    out = np.zeros(poses.shape[0])
    for b in range(poses.shape[0]):
        T = poses[b]
        for i in range(sample.shape[0]):
            x, y, z = moved(T, sample[i, 0], sample[i, 1], sample[i, 2])
            behind, reach = depth_behind(x, y, z, sensor, image, near)
            if not np.isinf(reach) and behind < -margin - share * reach:
                out[b] += 1.0
    out /= max(sample.shape[0], 1)
    return out


def fits(T: F64, source: View, target: View, radius: float) -> F64:
    """How much of both clouds lies on the other under each of B transforms, (B,) in [0, 1]."""
    there = _one_way(T, source, target, radius)
    back = _one_way(_inverses(T), target, source, radius)
    mean: F64 = 0.5 * (there + back)
    return mean


def _one_way(T: F64, moving: View, fixed: View, radius: float) -> F64:
    """Fit (B,) of the moving view's sample on the fixed view's surface."""
    fit: F64 = _fits(
        T,
        moving.sample,
        moving.sample_normals,
        fixed.points,
        fixed.normals,
        fixed.grid.space,
        radius * radius,
    )
    return fit


def intrusions(T: F64, source: View, target: View, margin: float, share: float) -> F64:
    """How much of both clouds stands in the other's free space under B transforms, (B,)."""
    there = _intrusions(T, source.sample, target.sensor, target.image, target.near, margin, share)
    back = _intrusions(
        _inverses(T), target.sample, source.sensor, source.image, source.near, margin, share
    )
    mean: F64 = 0.5 * (there + back)
    return mean
