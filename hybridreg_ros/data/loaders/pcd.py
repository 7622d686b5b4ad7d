# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""PCD files: header, points as text, binary or compressed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.loaders.lzf import decompress
from hybridreg_ros.data.loaders.tables import (
    ascii_rows,
    axes_of,
    count_of,
    records,
    split_header,
    tell_of_more,
    xyz_of,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

_TYPES = {
    f'{letter}{size}': f'<{letter.lower()}{size}'
    for letter, sizes in (('F', '248'), ('I', '1248'), ('U', '1248'))
    for size in sizes
}


def read_pcd(data: bytes, what: str) -> NDArray[np.float64]:
    """Points (N, 3) of the bytes of a PCD file; `what` names it in warnings.

    Raises:
        ValueError: it is none, is cut off, or has no x y z.
    """
    lines, body = split_header(data, b'\nDATA')
    entries = {words[0].upper(): words[1:] for line in lines if (words := line.split())}
    names = _entry(entries, 'FIELDS')
    counts = [count_of(c, 'COUNT') for c in entries.get('COUNT', ['1'] * len(names))]
    encoding = _entry(entries, 'DATA')[0].lower()
    size = [count_of(n, 'POINTS') for n in entries.get('POINTS', [])[:1]] or [
        count_of(_entry(entries, 'WIDTH')[0], 'WIDTH')
        * count_of(_entry(entries, 'HEIGHT')[0], 'HEIGHT')
    ]
    points = size[0]
    if len(counts) != len(names):
        raise ValueError(f'expected COUNT of {len(names)} fields, found {len(counts)}')
    if encoding == 'ascii':
        spread = [n for n, c in zip(names, counts, strict=True) for _ in range(min(c, len(body)))]
        rows = ascii_rows(body, spread, points)
        tell_of_more(what, body, points, lines=True)
        return rows
    kinds = _kinds(entries, len(names))
    shaped = [(k, (c,)) if c != 1 else k for k, c in zip(kinds, counts, strict=True)]
    if encoding == 'binary':
        table = records(body, names, shaped, points)
        tell_of_more(what, body, table.nbytes)
        return xyz_of(table, names)
    if encoding != 'binary_compressed':
        raise ValueError(
            f'unknown DATA {encoding[:30]}: expected ascii, binary or binary_compressed'
        )
    widths = [np.dtype(k).itemsize * c for k, c in zip(kinds, counts, strict=True)]
    return _compressed(body, (names, kinds, widths), points)


def _entry(entries: dict[str, list[str]], name: str) -> list[str]:
    if not entries.get(name):
        raise ValueError(f'its header has no {name}')
    return entries[name]


def _kinds(entries: dict[str, list[str]], fields: int) -> list[str]:
    """Type of each field; PCL writes TYPE in capital letters, others do not.

    Raises:
        ValueError: a type is unknown, or there are too few.
    """
    letters, sizes = _entry(entries, 'TYPE'), _entry(entries, 'SIZE')
    if not len(letters) == len(sizes) == fields:
        raise ValueError(
            f'expected TYPE and SIZE of {fields} fields, found {len(letters)} and {len(sizes)}'
        )
    names = [f'{k.upper()}{s}' for k, s in zip(letters, sizes, strict=True)]
    unknown = [name for name in names if name not in _TYPES]
    if unknown:
        raise ValueError(f'expected TYPE F, I or U of 1 to 8 bytes, found {unknown[0][:20]}')
    return [_TYPES[name] for name in names]


def _compressed(
    body: bytes, fields: tuple[list[str], list[str], list[int]], points: int
) -> NDArray[np.float64]:
    """binary_compressed stores one field after the other, compressed with LZF."""
    names, kinds, widths = fields
    if len(body) < 8:
        raise ValueError('cut off: no sizes of the compressed data')
    packed, size = (int(v) for v in np.frombuffer(body, dtype='<u4', count=2))
    if len(body) < 8 + packed or size != points * sum(widths):
        raise ValueError('cut off, or its sizes contradict each other')
    data = decompress(body[8 : 8 + packed], size)
    columns = []
    for k in axes_of(names):
        values = np.frombuffer(data, np.uint8, points * widths[k], points * sum(widths[:k]))
        values = values.reshape(points, widths[k])[:, : np.dtype(kinds[k]).itemsize]
        columns.append(np.ascontiguousarray(values).view(kinds[k]).reshape(-1).astype(np.float64))
    return np.stack(columns, axis=1)
