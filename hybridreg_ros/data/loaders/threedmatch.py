# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""3DMatch and 3DLoMatch: clouds with gt.log (transforms) and gt.info (information matrices)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.loaders.clouds import read_cloud
from hybridreg_ros.data.loaders.posed_frames import recorded_pair, rigid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.pair import PointPair

    F64 = NDArray[np.float64]

_SUFFIXES = ('.ply', '.npy', '.npz', '.pcd', '.bin')


@dataclass(frozen=True, eq=False)
class LogEntry:
    """One block of a .log or .info file.

    Attributes:
        target: number of the first cloud.
        source: number of the second cloud.
        count: number of clouds of the scene.
        matrix: (4, 4) T_target_source of a log, (6, 6) information of an info file.
    """

    target: int
    source: int
    count: int
    matrix: F64


def read_log(path: str | Path, size: int = 4) -> list[LogEntry]:
    """Blocks of a header line `target source count` and `size` lines of `size` numbers.

    Raises:
        FileFormatError: the file is missing, cut off, or holds something else.
    """
    try:
        words = Path(path).read_text(encoding='utf-8').split()
        values = np.array([float(w) for w in words])
    except OSError as error:
        raise FileFormatError(f'cannot read {path}: {error.strerror}') from None
    except ValueError as error:
        raise FileFormatError(f'{path}: expected numbers only, {error}') from None
    block = 3 + size * size
    if len(values) == 0 or len(values) % block:
        raise FileFormatError(
            f'{path}: expected blocks of {block} numbers, found {len(values)} numbers'
        )
    entries = []
    for row in values.reshape(-1, block):
        matrix = row[3:].reshape(size, size)
        entries.append(LogEntry(int(row[0]), int(row[1]), int(row[2]), matrix))
    return entries


class ThreeDMatch:
    """One scene of 3DMatch or 3DLoMatch, or another benchmark with the same kind of log.

    Args:
        truth: folder with `gt.log`, and `gt.info` where there is one.
        clouds: folder with the clouds; by default the same.
        pattern: name of a cloud without its suffix.
        voxel_size_m: suggested finest voxel.
        neighbours: False leaves out clouds that follow each other directly, as the benchmark
            does when it counts recall.

    Raises:
        FileFormatError: gt.log is missing or malformed.
    """

    def __init__(
        self,
        truth: str | Path,
        clouds: str | Path | None = None,
        *,
        pattern: str = 'cloud_bin_{}',
        voxel_size_m: float = 0.05,
        neighbours: bool = True,
    ) -> None:
        self.truth = Path(truth)
        self.clouds = Path(clouds) if clouds is not None else self.truth
        self.pattern, self.voxel_size_m = pattern, voxel_size_m
        entries = read_log(self.truth / 'gt.log')
        self.entries = [e for e in entries if neighbours or abs(e.source - e.target) > 1]
        info = self.truth / 'gt.info'
        self._information = (
            {(e.target, e.source): e.matrix for e in read_log(info, 6)} if info.exists() else {}
        )

    def information(self, index: int) -> F64 | None:
        """Information matrix (6, 6) of a pair, None where gt.info has none."""
        entry = self.entries[index]
        return self._information.get((entry.target, entry.source))

    def __len__(self) -> int:
        """Number of pairs."""
        return len(self.entries)

    def __getitem__(self, index: int) -> PointPair:
        """One pair: the log's second cloud is the source, its first the target."""
        entry = self.entries[index]
        what = f'{self.truth.name}-{entry.target}_{entry.source}'
        return recorded_pair(
            read_cloud(self._file(entry.source)),
            read_cloud(self._file(entry.target)),
            rigid(entry.matrix, what),
            self.voxel_size_m,
            what,
            thin_m=0.4 * self.voxel_size_m,
        )

    def _file(self, number: int) -> Path:
        stem = self.pattern.format(number)
        for suffix in _SUFFIXES:
            path = self.clouds / f'{stem}{suffix}'
            if path.exists():
                return path
        raise FileFormatError(
            f'{self.clouds} holds no cloud {stem} with one of {", ".join(_SUFFIXES)}'
        )
