# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pairs whose moving points are known: labelled lidar recordings, or generated pairs."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import ConfigError, FileFormatError
from hybridreg_ros.data.loaders.kitti import KittiOdometry
from hybridreg_ros.data.loaders.openers import open_pairs
from hybridreg_ros.data.pair import Label, PointPair

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.loaders.posed_frames import PairSource

    U8 = NDArray[np.uint8]

_EARLY_S = 1e-3


class Moving(IntEnum):
    """What is known of a point of a recording."""

    UNLABELLED = 0
    STATIC = 1
    MOVING = 2


@dataclass(frozen=True, eq=False)
class LabelledPair:
    """A pair, and which of its labels are known.

    Attributes:
        pair: metres; points without a label count as static in it.
        source_known: (N,) bool.
        target_known: (M,) bool.
    """

    pair: PointPair
    source_known: NDArray[np.bool_]
    target_known: NDArray[np.bool_]


class LabelledPairs(Protocol):
    """A sequence of labelled pairs."""

    def __len__(self) -> int:
        """Number of pairs."""

    def labelled(self, row: int) -> LabelledPair:
        """One pair."""


class LabelledScans(KittiOdometry):
    """A sequence like `KittiOdometry` with `moving/NAME.label`: a uint8 of `Moving` per point.

    Each scan is the target of one pair; the source is the first scan at least `gap_s` later.
    """

    def __init__(
        self, folder: str | Path, *, gap_s: float = 0.5, voxel_size_m: float = 0.3
    ) -> None:
        """Open a recording.

        Args:
            folder: with `velodyne/`, `moving/`, `poses.txt` and `times.txt`.
            gap_s: time between the scans of a pair, seconds.
            voxel_size_m: suggested finest voxel.

        Raises:
            FileFormatError: a file is missing or malformed.
            ConfigError: no two scans are that far apart.
        """
        super().__init__(folder, voxel_size_m=voxel_size_m)
        times = self.times_s
        if times is None or len(times) != len(self.files):
            raise FileFormatError(f'{folder}: expected times.txt with one time for each scan')
        later = np.searchsorted(times, times + gap_s - _EARLY_S)
        self.pairs = [(int(i), j) for j, i in enumerate(later) if i < len(times)]
        if not self.pairs:
            raise ConfigError(
                f'{folder}: expected scans {gap_s:g} s apart, found {times[-1] - times[0]:g} s '
                'from first to last'
            )

    def labels(self, index: int) -> U8:
        """Labels (N,) of the points of a scan, uint8 of `Moving`.

        Raises:
            FileFormatError: the file is missing, or does not fit the scan.
        """
        path = self.folder / 'moving' / f'{self.files[index].stem}.label'
        try:
            found = np.fromfile(path, np.uint8)
        except OSError as error:
            raise FileFormatError(f'cannot read {path}: {error.strerror}') from None
        if found.size and found.max() > Moving.MOVING:
            raise FileFormatError(f'{path}: expected 0, 1 or 2 per point, found {found.max()}')
        return found

    def labelled(self, row: int) -> LabelledPair:
        """One pair, all points of both scans.

        Raises:
            FileFormatError: labels are missing or do not fit.
        """
        i, j = self.pairs[row]
        clouds, labels = (self.cloud(i), self.cloud(j)), (self.labels(i), self.labels(j))
        for cloud, label, index in zip(clouds, labels, (i, j), strict=True):
            if len(cloud) != len(label):
                raise FileFormatError(
                    f'{self.folder}: expected {len(cloud)} labels of scan {index}, found '
                    f'{len(label)}'
                )
        moving = [
            np.where(label == Moving.MOVING, Label.MOVING_RIGID, Label.STATIC) for label in labels
        ]
        pair = PointPair(
            clouds[0],
            clouds[1],
            se3.inverse(self.poses[j]) @ self.poses[i],
            moving[0].astype(np.uint8),
            moving[1].astype(np.uint8),
            np.zeros(len(clouds[0]), np.uint16),
            np.zeros(len(clouds[1]), np.uint16),
            np.nan,
            float(np.concatenate(moving).astype(np.bool_).mean()),
            self.voxel_size_m,
            f'{self.folder.name}-{j:06d}_{i:06d}',
        )
        return LabelledPair(pair, labels[0] > 0, labels[1] > 0)


class GeneratedPairs:
    """Pairs of the generator, of which every label is known."""

    def __init__(self, pairs: PairSource) -> None:
        self._pairs = pairs

    def __len__(self) -> int:
        """Number of pairs."""
        return len(self._pairs)

    def labelled(self, row: int) -> LabelledPair:
        """One pair."""
        pair = self._pairs[row]
        n, m = len(pair.source), len(pair.target)
        return LabelledPair(pair, np.ones(n, np.bool_), np.ones(m, np.bool_))


def open_labelled(folder: str | Path, gap_s: float) -> LabelledPairs:
    """Labelled pairs of a recording with `moving/`, `gap_s` apart, or of the generator.

    Raises:
        FileFormatError: the folder holds neither.
        ConfigError: no two scans are that far apart.
    """
    folder = Path(folder)
    if (folder / 'moving').is_dir():
        return LabelledScans(folder, gap_s=gap_s)
    if next(folder.glob('*.hrs'), None) is None:
        raise FileFormatError(
            f'{folder}: expected a recording with moving/*.label, or pairs of `hybridreg generate`'
        )
    return GeneratedPairs(open_pairs(folder))
