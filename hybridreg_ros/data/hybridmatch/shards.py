# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Shards: many pairs in one small file, read one by one; a split is a folder of them.

A shard is: 8 bytes magic, uint32 count, count + 1 uint64 offsets, then one zlib blob per pair.
Points are stored as differences between multiples of 1 mm (of a larger step in large scenes).
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.pair import PointPair

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

_MAGIC = b'HRSHARD1'
_STEP_M = 0.001
_SIDES = ('source', 'target')


def encode_pair(pair: PointPair) -> bytes:
    """Compress one pair; coordinates are rounded to 1 mm (or to 1/30,000 of the extent)."""
    meta: dict[str, Any] = {
        'name': pair.name,
        'seed': pair.seed,
        'overlap': pair.overlap,
        'dynamic_share': pair.dynamic_share,
        'voxel_size_m': pair.voxel_size_m,
        'T_target_source': pair.T_target_source.reshape(-1).tolist(),
    }
    body = []
    for side in _SIDES:
        points: NDArray[np.float32] = getattr(pair, side)
        label, instance = getattr(pair, f'{side}_label'), getattr(pair, f'{side}_instance')
        reach = float(np.abs(points).max()) if len(points) else 0.0
        step = _STEP_M * max(1, int(np.ceil(reach / (32000 * _STEP_M))))
        whole = np.rint(points.astype(np.float64) / step).astype(np.int16)
        change = np.diff(whole, axis=0, prepend=np.zeros((1, 3), np.int16))
        meta[side] = {'count': len(points), 'step_m': step}
        planes = np.ascontiguousarray(change.T).view(np.uint8).reshape(3, -1, 2)
        body += [planes.transpose(0, 2, 1).tobytes(), label.astype(np.uint8).tobytes()]
        body.append(instance.astype('<u2').tobytes())
    head = json.dumps(meta, sort_keys=True).encode()
    return zlib.compress(struct.pack('<I', len(head)) + head + b''.join(body), 6)


def decode_pair(blob: bytes) -> PointPair:
    """Inverse of `encode_pair`, up to the rounding of the coordinates.

    Raises:
        FileFormatError: the blob is truncated or not one of ours.
    """
    try:
        raw = zlib.decompress(blob)
        size = struct.unpack_from('<I', raw)[0]
        meta = json.loads(raw[4 : 4 + size])
        at = 4 + size
        arrays: dict[str, NDArray[Any]] = {}
        for side in _SIDES:
            n, step = int(meta[side]['count']), float(meta[side]['step_m'])
            planes = np.frombuffer(raw, np.uint8, 6 * n, at).reshape(3, 2, n)
            change = np.ascontiguousarray(planes.transpose(0, 2, 1)).view('<i2')[..., 0]
            whole = np.cumsum(change, axis=1, dtype=np.int16).T
            arrays[side] = (whole.astype(np.float64) * step).astype(np.float32)
            arrays[f'{side}_label'] = np.frombuffer(raw, np.uint8, n, at + 6 * n).copy()
            instance = np.frombuffer(raw, '<u2', n, at + 7 * n)
            arrays[f'{side}_instance'] = instance.astype(np.uint16)
            at += 9 * n
        T = np.array(meta['T_target_source'], np.float64).reshape(4, 4)
        return PointPair(
            T_target_source=T,
            overlap=meta['overlap'],
            dynamic_share=meta['dynamic_share'],
            voxel_size_m=meta['voxel_size_m'],
            name=meta['name'],
            seed=meta['seed'],
            **arrays,
        )
    except (zlib.error, struct.error, ValueError, KeyError) as error:
        raise FileFormatError(
            f'a pair of a shard cannot be read ({error}); generate the shard again'
        ) from None


def write_shard(path: Path, blobs: Iterable[bytes]) -> None:
    """Write encoded pairs as one shard; the file appears complete or not at all."""
    blobs = list(blobs)
    offsets = np.cumsum([len(_MAGIC) + 4 + 8 * (len(blobs) + 1), *(len(b) for b in blobs)])
    partial = path.with_name(f'.{path.name}.{os.getpid()}.partial')
    with open(partial, 'wb') as stream:
        stream.write(_MAGIC + struct.pack('<I', len(blobs)) + offsets.astype('<u8').tobytes())
        stream.writelines(blobs)
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(partial, path)


def read_offsets(path: Path) -> NDArray[np.int64]:
    """Offsets (count + 1,) of the blobs of a shard.

    Raises:
        FileFormatError: the file is missing, truncated or not a shard.
    """
    try:
        with open(path, 'rb') as stream:
            head = stream.read(len(_MAGIC) + 4)
            if head[: len(_MAGIC)] != _MAGIC or len(head) < len(_MAGIC) + 4:
                raise FileFormatError(f'{path} is not a shard of pairs')
            count = struct.unpack('<I', head[len(_MAGIC) :])[0]
            table = stream.read(8 * (count + 1))
    except OSError as error:
        raise FileFormatError(f'cannot read shard {path}: {error.strerror}') from None
    offsets = np.frombuffer(table[: len(table) // 8 * 8], '<u8').astype(np.int64)
    if len(offsets) != count + 1 or offsets[-1] != path.stat().st_size:
        raise FileFormatError(f'shard {path} is truncated; delete it and generate again')
    return offsets


def read_blobs(path: Path) -> list[bytes]:
    """All encoded pairs of a shard.

    Raises:
        FileFormatError: as `read_offsets`.
    """
    offsets = read_offsets(path)
    raw = path.read_bytes()
    return [raw[a:b] for a, b in pairwise(offsets.tolist())]


class Split(Sequence[PointPair]):
    """Pairs of a folder of shards, read when asked for; constant memory.

    `refresh` takes up shards that have appeared since; pairs keep their numbers.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: set[str] = set()
        self._places: list[tuple[Path, int, int]] = []
        self.refresh()

    def refresh(self) -> int:
        """Look for new shards and return the number of pairs now known."""
        for path in sorted(self.folder.glob('*.hrs')):
            if path.name not in self._known:
                offsets = read_offsets(path)
                self._known.add(path.name)
                ends = pairwise(offsets.tolist())
                self._places += [(path, a, b) for a, b in ends]
        return len(self._places)

    def __len__(self) -> int:
        """Number of known pairs."""
        return len(self._places)

    @overload
    def __getitem__(self, index: int) -> PointPair: ...

    @overload
    def __getitem__(self, index: slice) -> list[PointPair]: ...

    def __getitem__(self, index: int | slice) -> PointPair | list[PointPair]:
        """Read a pair or a list of pairs.

        Raises:
            FileFormatError: the shard has vanished or is broken.
        """
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        path, start, end = self._places[index]
        try:
            with open(path, 'rb') as stream:
                stream.seek(start)
                return decode_pair(stream.read(end - start))
        except OSError as error:
            raise FileFormatError(f'cannot read shard {path}: {error.strerror}') from None


def open_split(folder: str | Path) -> Split:
    """Open a folder of shards.

    Raises:
        FileFormatError: the folder does not exist, or one of its shards is broken.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileFormatError(f'no split at {folder}: make one with `hybridreg generate`')
    return Split(folder)
