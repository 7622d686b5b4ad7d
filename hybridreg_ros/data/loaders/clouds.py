# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Single clouds from and to files: .npy, .npz, .ply, .pcd and KITTI .bin."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.loaders.columns import points_in_rows, read_bin
from hybridreg_ros.data.loaders.lzf import decompress

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

NPZ_KEYS = ('points', 'xyz', 'cloud', 'pos', 'arr_0')
_PLY_TYPES = {
    'char': 'i1', 'int8': 'i1', 'uchar': 'u1', 'uint8': 'u1', 'short': 'i2', 'int16': 'i2',
    'ushort': 'u2', 'uint16': 'u2', 'int': 'i4', 'int32': 'i4', 'uint': 'u4', 'uint32': 'u4',
    'float': 'f4', 'float32': 'f4', 'double': 'f8', 'float64': 'f8',
}  # fmt: skip
_PLY_ORDER = {'binary_little_endian': '<', 'binary_big_endian': '>'}


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
    readers = {'.npy': _npy, '.npz': _npz, '.ply': _ply, '.pcd': _pcd,
               '.bin': lambda file: read_bin(file, columns)}  # fmt: skip
    if path.suffix.lower() not in readers:
        raise FileFormatError(f'{path}: expected one of {", ".join(readers)}')
    try:
        points = points_in_rows(readers[path.suffix.lower()](path))
    except OSError as error:
        raise FileFormatError(f'cannot read cloud {path}: {error.strerror or error}') from None
    except (ValueError, LookupError, EOFError, zipfile.BadZipFile) as error:
        text = ' '.join(str(error).split())
        raise FileFormatError(f'{path} is not a readable {path.suffix} cloud: {text}') from None
    if points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in 'fiu':
        raise FileFormatError(
            f'{path}: expected numbers of shape (N, 3), found {points.dtype} {points.shape}'
        )
    return np.ascontiguousarray(points[:, :3], dtype=np.float32)


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
            raise FileFormatError(f'{path}: expected .npy, .npz, .ply, .pcd or .bin')
    except OSError as error:
        raise FileFormatError(f'cannot write {path}: {error.strerror or error}') from None


def _npy(path: Path) -> NDArray[Any]:
    return np.asarray(np.load(path, allow_pickle=False))


def _npz(path: Path) -> NDArray[Any]:
    with np.load(path, allow_pickle=False) as archive:
        name = next((k for k in NPZ_KEYS if k in archive.files), None)
        if name is None:
            raise ValueError(
                f'no array named {", ".join(NPZ_KEYS)}; found {", ".join(archive.files) or "none"}'
            )
        return np.asarray(archive[name])


def _split_header(data: bytes, end: bytes) -> tuple[list[str], bytes]:
    """Header lines up to and including the line that starts with `end`, and the rest."""
    place = data.find(end)
    stop = data.find(b'\n', place + 1)
    if place < 0 or stop < 0:
        raise ValueError(f'no {end.decode().strip()} line')
    return data[:stop].decode('ascii', 'replace').splitlines(), data[stop + 1 :]


def _ply(path: Path) -> NDArray[Any]:
    data = path.read_bytes()
    if not data.startswith(b'ply'):
        raise ValueError('it does not begin with "ply"')
    header, body = _split_header(data, b'end_header')
    kind, count, names, types, inside = '', -1, [], [], False
    for line in header:
        words = line.split()
        if words[:1] == ['format']:
            kind = words[1]
        elif words[:1] == ['element']:
            if count < 0 and words[1] != 'vertex':
                raise ValueError(f'element {words[1]} stands before vertex')
            inside = words[1] == 'vertex'
            count = int(words[2]) if inside else count
        elif words[:1] == ['property'] and inside:
            if words[1] == 'list':
                raise ValueError('vertices with lists are not supported')
            names.append(words[2])
            types.append(_PLY_TYPES[words[1]])
    if kind == 'ascii':
        return _ascii_columns(body, names, count)
    layout = np.dtype([(n, _PLY_ORDER[kind] + t) for n, t in zip(names, types, strict=True)])
    return _xyz(_records(body, layout, count))


def _ascii_columns(body: bytes, names: list[str], count: int) -> NDArray[np.float64]:
    """Coordinates of `count` lines of numbers."""
    rows = [line.split() for line in body.decode('ascii', 'replace').splitlines()[:count]]
    if len(rows) < count:
        raise ValueError(f'cut off: {count} points announced, {len(rows)} found')
    order = [names.index(axis) for axis in 'xyz']
    table = [[float(row[k]) for k in order] for row in rows]
    return np.array(table, dtype=np.float64).reshape(-1, 3)


def _records(body: bytes, layout: np.dtype[Any], count: int) -> NDArray[Any]:
    if len(body) < count * layout.itemsize:
        raise ValueError(
            f'cut off: {count} points need {count * layout.itemsize} bytes, found {len(body)}'
        )
    return np.frombuffer(body, dtype=layout, count=count)


def _xyz(table: NDArray[Any]) -> NDArray[np.float64]:
    missing = [axis for axis in 'xyz' if axis not in (table.dtype.names or ())]
    if missing:
        raise ValueError(
            f'no field {", ".join(missing)}; found {", ".join(table.dtype.names or ())}'
        )
    return np.stack([table[axis].astype(np.float64) for axis in 'xyz'], axis=1)


def _pcd(path: Path) -> NDArray[Any]:
    header, body = _split_header(path.read_bytes(), b'\nDATA')
    entries = {words[0]: words[1:] for line in header if (words := line.split())}
    names, sizes, kinds = entries['FIELDS'], entries['SIZE'], entries['TYPE']
    counts = [int(c) for c in entries.get('COUNT', ['1'] * len(names))]
    points = int(entries['POINTS'][0])
    encoding = entries['DATA'][0]
    if encoding == 'ascii':
        spread = [n for n, c in zip(names, counts, strict=True) for _ in range(c)]
        return _ascii_columns(body, spread, points)
    fields = [
        (n, '<' + {'F': 'f', 'I': 'i', 'U': 'u'}[k] + s, (c,) if c > 1 else ())
        for n, k, s, c in zip(names, kinds, sizes, counts, strict=True)
    ]
    # PCL names padding '_' and repeats it: numpy wants every name once.
    layout = np.dtype([(f'_{i}' if f[0] == '_' else f[0], *f[1:]) for i, f in enumerate(fields)])
    if encoding == 'binary':
        return _xyz(_records(body, layout, points))
    if encoding != 'binary_compressed':
        raise ValueError(f'unknown DATA {encoding}')
    return _compressed_columns(body, layout, points)


def _compressed_columns(body: bytes, layout: np.dtype[Any], points: int) -> NDArray[Any]:
    """binary_compressed stores one field after the other, compressed with LZF."""
    packed, size = (int(v) for v in np.frombuffer(body, dtype='<u4', count=2))
    if len(body) < 8 + packed or size != points * layout.itemsize:
        raise ValueError('cut off, or its sizes contradict each other')
    data = decompress(body[8 : 8 + packed], size)
    columns, offset = {}, 0
    for name in layout.names or ():
        field = layout[name]
        if name in 'xyz':
            columns[name] = np.frombuffer(data, field, points, offset).astype(np.float64)
        offset += points * field.itemsize
    return np.stack([columns[axis] for axis in 'xyz'], axis=1)
