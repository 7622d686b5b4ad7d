# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Reading and writing of single clouds: .npy, .npz, .ply, .pcd and KITTI .bin."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.loaders.columns import points_in_rows, read_bin
from hybridreg_ros.data.loaders.pcd import read_pcd
from hybridreg_ros.data.loaders.ply import read_ply
from hybridreg_ros.data.loaders.tables import tell_of_more

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

DAMAGE = (
    ValueError,
    LookupError,
    EOFError,
    MemoryError,
    ArithmeticError,
    TypeError,
    SyntaxError,
    RuntimeError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
"""What numpy and zipfile raise on damaged files."""
SUFFIXES = ('.ply', '.pcd', '.npy', '.npz', '.bin')
NPZ_KEYS = ('points', 'xyz', 'cloud', 'pos', 'arr_0')


def read_cloud(path: str | Path, columns: int | None = None) -> NDArray[np.float32]:
    """Points (N, 3) float32 of a file, metres; rows may hold NaN.

    Args:
        path: .npy, .npz (also with points as columns), .ply, .pcd, or .bin (float32, no header).
        columns: values per point of a .bin file; None tells it by the values.

    Raises:
        FileFormatError: missing, unknown, damaged, or without x y z.
    """
    path = Path(path)
    readers: dict[str, Callable[[Path], NDArray[Any]]]
    readers = {
        '.npy': _npy,
        '.npz': _npz,
        '.ply': lambda file: read_ply(file.read_bytes(), str(file)),
        '.pcd': lambda file: read_pcd(file.read_bytes(), str(file)),
        '.bin': lambda file: read_bin(file, columns),
    }
    if path.suffix.lower() not in readers:
        raise FileFormatError(f'{path}: expected one of {", ".join(readers)}')
    try:
        with np.errstate(over='ignore', invalid='ignore'):  # bytes that are no numbers
            points = points_in_rows(readers[path.suffix.lower()](path))
            if points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in 'fiu':
                raise FileFormatError(
                    f'{path}: expected numbers of shape (N, 3), found {points.dtype} '
                    f'{points.shape}'
                )
            return np.ascontiguousarray(points[:, :3], dtype=np.float32)
    except OSError as error:
        raise FileFormatError(f'cannot read cloud {path}: {error.strerror or error}') from None
    except DAMAGE as error:
        text = ' '.join(str(error).split()) or type(error).__name__
        raise FileFormatError(f'{path} is not a readable {path.suffix} cloud: {text}') from None


def write_cloud(path: str | Path, points: NDArray[np.floating]) -> None:
    """Write points (N, 3), metres, as .npy, .npz, binary .ply, binary .pcd or KITTI .bin.

    Raises:
        FileFormatError: the suffix is unknown or the file cannot be written.
    """
    path = Path(path)
    xyz = np.ascontiguousarray(points, dtype='<f4').reshape(-1, 3)
    n = len(xyz)
    heads = {
        '.ply': 'ply\nformat binary_little_endian 1.0\n'
        f'element vertex {n}\nproperty float x\nproperty float y\nproperty float z\nend_header\n',
        '.pcd': '# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n'
        f'WIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n',
    }
    suffix = path.suffix.lower()
    try:
        if suffix in heads:
            path.write_bytes(heads[suffix].encode('ascii') + xyz.tobytes())
        elif suffix == '.bin':
            path.write_bytes(np.concatenate([xyz, np.zeros((n, 1), '<f4')], axis=1).tobytes())
        elif suffix == '.npy':
            np.save(path, xyz)
        elif suffix == '.npz':
            np.savez_compressed(path, points=xyz)
        else:
            raise FileFormatError(f'{path}: expected {", ".join(SUFFIXES)}')
    except OSError as error:
        raise FileFormatError(f'cannot write {path}: {error.strerror or error}') from None


def _npy(path: Path) -> NDArray[Any]:
    with path.open('rb') as stream:
        array = np.asarray(np.load(stream, allow_pickle=False))
        tell_of_more(str(path), stream.read(1024), 0)
    return array


def _npz(path: Path) -> NDArray[Any]:
    with np.load(path, allow_pickle=False) as archive:
        name = next((k for k in NPZ_KEYS if k in archive.files), None)
        if name is None:
            raise ValueError(
                f'no array named {", ".join(NPZ_KEYS)}; found {", ".join(archive.files) or "none"}'
            )
        return np.asarray(archive[name])
