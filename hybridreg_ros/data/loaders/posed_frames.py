# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the loaders of recorded data share: text tables, poses, and pairs of posed frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from hybridreg_ros.core import quaternion, se3
from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.meshes.geometry import voxel_thin
from hybridreg_ros.data.overlap import overlap_share
from hybridreg_ros.data.pair import PointPair

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]


class PairSource(Protocol):
    """Every loader of this package: a sequence of pairs."""

    def __len__(self) -> int:
        """Number of pairs."""

    def __getitem__(self, index: int) -> PointPair:
        """One pair."""


def read_numbers(path: Path, columns: int | None = None) -> F64:
    """Rows (N, columns) of a text file of numbers; empty lines and lines with # are skipped.

    Raises:
        FileFormatError: the file is missing, holds something else, or rows of another length.
    """
    rows: list[list[float]] = []
    try:
        lines = path.read_text(encoding='utf-8').splitlines()
    except OSError as error:
        raise FileFormatError(f'cannot read {path}: {error.strerror}') from None
    except UnicodeDecodeError:
        raise FileFormatError(f'{path} is not a text file') from None
    for number, line in enumerate(lines, 1):
        words = line.split('#')[0].replace(',', ' ').split()
        if not words:
            continue
        try:
            rows.append([float(w) for w in words])
        except ValueError:
            raise FileFormatError(f'{path}:{number}: expected numbers, found {line!r}') from None
        wanted = columns if columns is not None else len(rows[0])
        if len(rows[-1]) != wanted:
            raise FileFormatError(
                f'{path}:{number}: expected {wanted} numbers, found {len(rows[-1])}'
            )
    if not rows:
        raise FileFormatError(f'{path} holds no numbers')
    return np.array(rows, dtype=np.float64)


def rigid(values: F64, what: str) -> F64:
    """A (4, 4) transform from 12 or 16 numbers, its rotation made exact.

    Raises:
        FileFormatError: the numbers are no rigid transform; the message names `what`.
    """
    T = np.eye(4)
    flat = np.asarray(values, dtype=np.float64).ravel()
    T.ravel()[: len(flat)] = flat
    if len(flat) not in (12, 16) or not se3.is_rigid(T, 1e-2):
        raise FileFormatError(f'{what}: expected a rigid 4x4 transform, found {flat.tolist()}')
    return se3.orthonormalise(T)


def from_quaternion(place: F64, xyzw: F64, what: str) -> F64:
    """A (4, 4) transform from a place (3,) and a quaternion x y z w.

    Raises:
        FileFormatError: the quaternion is zero; the message names `what`.
    """
    try:
        R = quaternion.from_quaternion(*(float(v) for v in xyzw))
    except FileFormatError as error:
        raise FileFormatError(f'{what}: expected a unit quaternion: {error}') from None
    return se3.transform(R, np.asarray(place, dtype=np.float64))


def recorded_pair(
    source: F32,
    target: F32,
    T_target_source: F64,
    voxel_size_m: float,
    name: str,
    *,
    overlap_m: float | None = None,
    thin_m: float = 0.0,
) -> PointPair:
    """A pair without labels: every point counts as static.

    Args:
        source: (N, 3), metres; rows with NaN or inf are dropped.
        target: (M, 3).
        T_target_source: (4, 4).
        voxel_size_m: suggested finest voxel.
        name: of the pair.
        overlap_m: radius of the overlap that is measured; 1.5 voxels by default.
        thin_m: keep one point per voxel of this size; 0 keeps all.
    """
    clouds = []
    for cloud in (source, target):
        points = cloud[np.isfinite(cloud).all(axis=1)]
        clouds.append(points[np.sort(voxel_thin(points, thin_m))] if thin_m > 0.0 else points)
    radius = 1.5 * voxel_size_m if overlap_m is None else overlap_m
    n, m = len(clouds[0]), len(clouds[1])
    return PointPair(
        clouds[0],
        clouds[1],
        T_target_source,
        np.zeros(n, np.uint8),
        np.zeros(m, np.uint8),
        np.zeros(n, np.uint16),
        np.zeros(m, np.uint16),
        overlap_share(clouds[0], clouds[1], T_target_source, radius),
        0.0,
        voxel_size_m,
        name,
    )


class FramePairs:
    """Pairs of posed frames of one recording; the later frame is the source.

    Subclasses give `cloud`.

    Attributes:
        folder: of the recording.
        poses: (N, 4, 4) T_world_sensor of each frame.
        pairs: (source, target) rows of frames.
        voxel_size_m: suggested finest voxel.
    """

    def __init__(
        self, folder: Path, poses: F64, pairs: list[tuple[int, int]], voxel_size_m: float
    ) -> None:
        self.folder, self.poses, self.pairs = folder, poses, pairs
        self.voxel_size_m = voxel_size_m

    def cloud(self, index: int) -> F32:
        """Points (N, 3) of a frame, sensor frame, metres."""
        raise NotImplementedError

    def __len__(self) -> int:
        """Number of pairs."""
        return len(self.pairs)

    def __getitem__(self, index: int) -> PointPair:
        """One pair, thinned to 0.4 voxels."""
        i, j = self.pairs[index]
        T = se3.inverse(self.poses[j]) @ self.poses[i]
        return recorded_pair(
            self.cloud(i),
            self.cloud(j),
            T,
            self.voxel_size_m,
            f'{self.folder.name}-{j:06d}_{i:06d}',
            thin_m=0.4 * self.voxel_size_m,
        )


def pairs_apart(poses: F64, distance_m: float) -> list[tuple[int, int]]:
    """For each frame j, the first later frame i that is at least `distance_m` away: (i, j)."""
    place = poses[:, :3, 3]
    pairs = []
    for j in range(len(place)):
        away = np.linalg.norm(place[j + 1 :] - place[j], axis=1) >= distance_m
        if away.any():
            pairs.append((j + 1 + int(away.argmax()), j))
    return pairs


def pairs_stepped(count: int, step: int) -> list[tuple[int, int]]:
    """Frames `step` apart: (j + step, j)."""
    return [(j + step, j) for j in range(0, count - step)]
