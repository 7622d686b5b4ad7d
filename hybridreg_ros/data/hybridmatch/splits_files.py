# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Files of a split: shards of pairs, or the authors' layout of one folder per pair."""

from __future__ import annotations

import io
import json
import os
import shutil
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from hybridreg_ros.data.hybridmatch.shards import (
    encode_pair,
    read_blobs,
    read_offsets,
    write_shard,
)
from hybridreg_ros.data.pair import Label

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from hybridreg_ros.data.hybridmatch.take import Sample

NOTES = '.blocks'
"""Folder in a begun split with what is known of each finished block."""


def pack(sample: Sample, layout: str) -> dict[str, bytes]:
    """Files of one pair by name, as a layout wants them.

    Args:
        sample: the pair; the official layout needs its `still`.
        layout: 'shards' or 'official'.
    """
    pair = sample.pair
    if layout == 'shards':
        return {'pair.hrs': encode_pair(pair)}
    assert sample.still is not None
    return {
        'src.npy': _npy(pair.source),
        'ref.npy': _npy(pair.target),
        'ref_wo_anim.npy': _npy(sample.still),
        'relative_transform.npy': _npy(pair.T_target_source),
        'src_back_indices.json': _background(pair.source_label),
        'ref_back_indices.json': _background(pair.target_label),
    }


def _npy(array: NDArray[np.floating]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def _background(label: NDArray[np.uint8]) -> bytes:
    rows: list[int] = np.flatnonzero(label == Label.STATIC).tolist()
    return json.dumps({'back_indices': rows}).encode()


class Layout(Protocol):
    """How the pairs of a block lie in a folder."""

    def write(self, folder: Path, first_seed: int, made: Made) -> None:
        """Write the pairs of a block."""

    def complete(self, folder: Path, first_seed: int, rows: Sequence[Row]) -> bool:
        """Whether the pairs of a block are all there."""

    def trim(self, folder: Path, rows: Sequence[Row]) -> None:
        """Remove every pair that is not one of `rows`, all pairs of the split in order."""


class Shards:
    """One shard a block; a block without pairs has none."""

    def write(self, folder: Path, first_seed: int, made: Made) -> None:
        """Write the pairs of a block."""
        if made.rows:
            path = folder / f'{first_seed:07d}.hrs'
            write_shard(path, [files['pair.hrs'] for files in made.files])

    def complete(self, folder: Path, first_seed: int, rows: Sequence[Row]) -> bool:
        """Whether the pairs of a block are all there."""
        path = folder / f'{first_seed:07d}.hrs'
        if not rows:
            return not path.exists()
        return path.exists() and len(read_offsets(path)) - 1 == len(rows)

    def trim(self, folder: Path, rows: Sequence[Row]) -> None:
        """Cut the last shard, and delete those behind it."""
        left = len(rows)
        for path in sorted(folder.glob('*.hrs')):
            blobs = read_blobs(path)
            if left <= 0:
                path.unlink()
            elif len(blobs) > left:
                write_shard(path, blobs[:left])
            left -= len(blobs)


class Official:
    """One folder a pair: ref, src, ref_wo_anim, relative_transform and the background rows."""

    def write(self, folder: Path, first_seed: int, made: Made) -> None:
        """Write the pairs of a block; each folder appears complete or not at all."""
        del first_seed
        for row, files in zip(made.rows, made.files, strict=True):
            partial = folder / f'.{row.name}.{os.getpid()}.partial'
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir()
            for name, data in files.items():
                (partial / name).write_bytes(data)
            shutil.rmtree(folder / row.name, ignore_errors=True)
            os.replace(partial, folder / row.name)

    def complete(self, folder: Path, first_seed: int, rows: Sequence[Row]) -> bool:
        """Whether the pairs of a block are all there."""
        del first_seed
        return all((folder / row.name).is_dir() for row in rows)

    def trim(self, folder: Path, rows: Sequence[Row]) -> None:
        """Delete the folders of all other pairs."""
        kept = {row.name for row in rows}
        for path in folder.iterdir():
            if path.is_dir() and not path.name.startswith('.') and path.name not in kept:
                shutil.rmtree(path)


LAYOUTS: dict[str, Layout] = {'shards': Shards(), 'official': Official()}


def write_text(path: Path, text: str) -> None:
    """Write a text file that appears complete or not at all."""
    partial = path.with_name(f'.{path.name}.{os.getpid()}.partial')
    partial.write_text(text, encoding='utf-8')
    os.replace(partial, path)


def clean(folder: Path) -> None:
    """Delete what killed runs left half-written."""
    for path in folder.glob('.*.partial'):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


@dataclass(frozen=True)
class Row:
    """What the statistics of a split need to know of one pair.

    Attributes:
        name: of the pair.
        overlap: share of the static source points that the target sees too.
        dynamic_share: share of non-static points.
        source_points: number of points.
        target_points: number of points.
        displacement_m: mean displacement of the key figure's vertices.
    """

    name: str
    overlap: float
    dynamic_share: float
    source_points: int
    target_points: int
    displacement_m: float


@dataclass(frozen=True)
class Made:
    """The pairs of a block: rows, and the files of each by name."""

    rows: tuple[Row, ...]
    files: tuple[dict[str, bytes], ...]
