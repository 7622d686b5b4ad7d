# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""HybridMatch as its authors released it: one folder a pair, with lists of background points."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from natsort import natsorted

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.core.se3 import apply
from hybridreg_ros.data.loaders.clouds import read_cloud
from hybridreg_ros.data.loaders.posed_frames import rigid
from hybridreg_ros.data.overlap import near_cells
from hybridreg_ros.data.pair import Label, PointPair

if TYPE_CHECKING:
    from numpy.typing import NDArray

_FILES = ('ref.npy', 'src.npy', 'relative_transform.npy')


class OfficialHybridMatch:
    """Pairs in the released layout; foreground points count as deforming (no more is known).

    Args:
        folder: any folder above the pairs' folders.
        still: True takes the target without animation (`ref_wo_anim.npy`), all points static:
            the rigid-only split.
        voxel_size_m: suggested finest voxel.

    Raises:
        FileFormatError: there is no pair below the folder.
    """

    def __init__(
        self, folder: str | Path, *, still: bool = False, voxel_size_m: float = 0.05
    ) -> None:
        self.folder, self.still, self.voxel_size_m = Path(folder), still, voxel_size_m
        places = {p.parent for p in self.folder.rglob('relative_transform.npy')}
        self.places = natsorted(p for p in places if not p.name.startswith('.'))
        if not self.places:
            raise FileFormatError(f'{folder}: expected folders with {", ".join(_FILES)}')

    def __len__(self) -> int:
        """Number of pairs."""
        return len(self.places)

    def __getitem__(self, index: int) -> PointPair:
        """One pair.

        Raises:
            FileFormatError: a file of it is missing or malformed.
        """
        place = self.places[index]
        source = read_cloud(place / 'src.npy')
        target = read_cloud(place / ('ref_wo_anim.npy' if self.still else 'ref.npy'))
        T = rigid(_array(place / 'relative_transform.npy'), str(place))
        if self.still:
            s_label, t_label = np.zeros(len(source), np.uint8), np.zeros(len(target), np.uint8)
        else:
            s_label = _labels(place / 'src_back_indices.json', len(source))
            t_label = _labels(place / 'ref_back_indices.json', len(target))
        near = near_cells(
            apply(T, source[s_label == 0].astype(np.float64)),
            target[t_label == 0],
            self.voxel_size_m,
        )
        moving = (s_label > 0).sum() + (t_label > 0).sum()
        return PointPair(
            source,
            target,
            T,
            s_label,
            t_label,
            (s_label > 0).astype(np.uint16),
            (t_label > 0).astype(np.uint16),
            float(near.mean()) if len(near) else 0.0,
            float(moving) / max(len(source) + len(target), 1),
            self.voxel_size_m,
            place.relative_to(self.folder).as_posix(),
        )


def _array(path: Path) -> NDArray[np.float64]:
    try:
        return np.asarray(np.load(path, allow_pickle=False), dtype=np.float64)
    except OSError as error:
        raise FileFormatError(f'cannot read {path}: {error.strerror or error}') from None
    except (ValueError, EOFError) as error:
        raise FileFormatError(f'{path} is not an array of numbers: {error}') from None


def _labels(path: Path, count: int) -> NDArray[np.uint8]:
    """Labels (count,): static where listed, deforming elsewhere."""
    try:
        rows = np.array(json.loads(path.read_text(encoding='utf-8'))['back_indices'], np.int64)
    except OSError as error:
        raise FileFormatError(f'cannot read {path}: {error.strerror}') from None
    except (ValueError, KeyError, TypeError):
        raise FileFormatError(f'{path}: expected {{"back_indices": [numbers]}}') from None
    if len(rows) and (rows.min() < 0 or rows.max() >= count):
        raise FileFormatError(
            f'{path}: expected rows below {count}, found {rows.min()} to {rows.max()}'
        )
    labels = np.full(count, Label.DEFORMING, np.uint8)
    labels[rows] = Label.STATIC
    return labels
