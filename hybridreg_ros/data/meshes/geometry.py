# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Small geometry shared by the generators: moving meshes, smooth noise, thinning."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.meshes.scene import Mesh

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    F64 = NDArray[np.float64]


def rot_z(angle_rad: float) -> F64:
    """Rotation (3, 3) about z."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rot_x(angle_rad: float) -> F64:
    """Rotation (3, 3) about x."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def random_rotation(rng: np.random.Generator) -> F64:
    """Uniform rotation (3, 3), from a random unit quaternion."""
    w, x, y, z = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def cross(a: ArrayLike, b: ArrayLike) -> F64:
    """Cross product of rows (..., 3): the bits of np.cross at a fraction of its overhead."""
    p, q = np.asarray(a, np.float64), np.asarray(b, np.float64)
    x, y, z, u, v, w = p[..., 0], p[..., 1], p[..., 2], q[..., 0], q[..., 1], q[..., 2]
    first = y * w - z * v
    product = np.empty((*first.shape, 3))
    product[..., 0], product[..., 1], product[..., 2] = first, z * u - x * w, x * v - y * u
    return product


def look_at(eye: F64, target: F64, roll_rad: ArrayLike = 0.0) -> F64:
    """Poses T_world_camera (..., 4, 4) of optical frames at `eye` that look at `target`, z up.

    Args:
        eye: (..., 3) places, metres.
        target: (..., 3) what is in the middle of the image.
        roll_rad: (...) turn about the optical axis.
    """
    ahead = target - eye
    z = ahead / np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-9)
    side = cross(z, [0.0, 0.0, 1.0])
    wide = np.linalg.norm(side, axis=-1, keepdims=True)
    # Straight up or down, any side is as good.
    side = np.where(wide < 1e-6, [1.0, 0.0, 0.0], side / np.maximum(wide, 1e-9))
    y = cross(z, side)
    c, s = np.cos(roll_rad)[..., None], np.sin(roll_rad)[..., None]
    T = np.zeros((*np.shape(eye)[:-1], 4, 4))
    T[..., :3, :3] = np.stack([c * side + s * y, c * y - s * side, z], axis=-1)
    T[..., :3, 3] = eye
    T[..., 3, 3] = 1.0
    return T


def moved(
    mesh: Mesh,
    t: ArrayLike = (0.0, 0.0, 0.0),
    R: F64 | None = None,
    scale: ArrayLike = 1.0,
) -> Mesh:
    """Mesh scaled, then rotated, then translated."""
    v = mesh.vertices * np.asarray(scale, np.float32)
    if R is not None:
        v = v @ R.T.astype(np.float32)
    return Mesh((v + np.asarray(t, np.float32)).astype(np.float32), mesh.faces)


def turned(mesh: Mesh, yaw_rad: float, t: ArrayLike = (0.0, 0.0, 0.0)) -> Mesh:
    """Mesh turned about z, then translated."""
    return moved(mesh, t, rot_z(yaw_rad))


def bounds(mesh: Mesh) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Lowest and highest corner (3,), (3,) of a mesh."""
    return mesh.vertices.min(0), mesh.vertices.max(0)


def fitted(mesh: Mesh, size: ArrayLike) -> Mesh:
    """Mesh scaled per axis to a size (3,), centred in x and y, standing on z = 0."""
    low, high = bounds(mesh)
    scale = np.asarray(size, np.float32) / np.maximum(high - low, 1e-6)
    v = (mesh.vertices - 0.5 * (low + high)) * scale
    v[:, 2] += 0.5 * float(np.asarray(size)[2])
    return Mesh(v.astype(np.float32), mesh.faces)


class SmoothNoise:
    """A random smooth scalar field: a few plane waves of falling amplitude.

    Args:
        rng: source of randomness.
        wavelength_m: shortest and longest wavelength, metres.
        amplitude: standard deviation of the field.
        waves: number of plane waves.
        dim: dimension of the points.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        wavelength_m: tuple[float, float],
        amplitude: float,
        waves: int = 6,
        dim: int = 3,
    ) -> None:
        low, high = np.log(wavelength_m)
        length = np.exp(rng.uniform(low, high, size=waves))
        direction = rng.normal(size=(waves, dim))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        self._k = (2.0 * np.pi / length[:, None] * direction).T
        self._phase = rng.uniform(0.0, 2.0 * np.pi, waves)
        gain = length / np.sqrt((length**2).sum())
        self._gain = amplitude * np.sqrt(2.0) * gain

    def __call__(self, points: NDArray[np.floating]) -> F64:
        """Field values (N,) at points (N, dim)."""
        value: F64 = np.sin(points @ self._k + self._phase) @ self._gain
        return value


def voxel_thin(points: NDArray[np.float32], voxel_m: float) -> NDArray[np.int64]:
    """Rows of one point per voxel: the first in input order; rows come sorted by voxel.

    Args:
        points: (N, 3) finite, metres.
        voxel_m: edge of a voxel, metres.

    Returns:
        (K,) int64 rows of `points`.
    """
    if len(points) == 0:
        return np.zeros(0, np.int64)
    key = np.zeros(len(points), np.int64)
    for axis in (2, 1, 0):
        cell = np.floor(points[:, axis] / voxel_m).astype(np.int64)
        cell -= cell.min()
        key = key * (cell.max() + 1) + cell
    # Sorting keys that carry their row is several times faster than sorting rows by key.
    count = len(points)
    tagged = np.sort(key * count + np.arange(count))
    voxel = tagged // count
    begins = np.append(True, voxel[1:] != voxel[:-1])
    first: NDArray[np.int64] = tagged[begins] % count
    return first
