# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""PLY files: header, elements in any order, vertices as text or binary."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hybridreg_ros.data.loaders.tables import (
    ascii_rows,
    count_of,
    records,
    split_header,
    tell_of_more,
    xyz_of,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

_TYPES = {
    'char': 'i1',
    'int8': 'i1',
    'uchar': 'u1',
    'uint8': 'u1',
    'short': 'i2',
    'int16': 'i2',
    'ushort': 'u2',
    'uint16': 'u2',
    'int': 'i4',
    'int32': 'i4',
    'uint': 'u4',
    'uint32': 'u4',
    'float': 'f4',
    'float32': 'f4',
    'double': 'f8',
    'float64': 'f8',
}
_ORDERS = {'ascii': '', 'binary_little_endian': '<', 'binary_big_endian': '>'}


class _Property(NamedTuple):
    """Name and type of a property; of a list also the type of its length."""

    name: str
    kind: str
    length: str = ''


class _Element(NamedTuple):
    """Name, number of rows and properties of an element."""

    name: str
    rows: int
    properties: list[_Property]

    @property
    def has_lists(self) -> bool:
        return any(p.length for p in self.properties)


def read_ply(data: bytes, what: str) -> NDArray[np.float64]:
    """Vertices (N, 3) of the bytes of a PLY file; `what` names it in warnings.

    Raises:
        ValueError: it is none, is cut off, or its vertices have no x y z.
    """
    if not data.startswith(b'ply'):
        raise ValueError('expected it to begin with "ply"')
    lines, body = split_header(data, b'\nend_header')
    form, elements = _header(lines)
    vertex = next((e for e in elements if e.name == 'vertex'), None)
    if vertex is None:
        names = ', '.join(e.name for e in elements) or 'none'
        raise ValueError(f'expected an element vertex, found {names}')
    if vertex.has_lists:
        raise ValueError('vertices with lists are not supported')
    fields = [p.name for p in vertex.properties]
    before = elements[: elements.index(vertex)]
    last = vertex is elements[-1]
    if form == 'ascii':
        skipped = sum(e.rows for e in before)
        points = ascii_rows(body, fields, vertex.rows, skipped)
        if last:
            tell_of_more(what, body, skipped + vertex.rows, lines=True)
        return points
    order = _ORDERS[form]
    start = 0
    for element in before:
        start = _skip(body, start, element, order)
    kinds = [order + p.kind for p in vertex.properties]
    table = records(body[start:], fields, kinds, vertex.rows)
    if last:
        tell_of_more(what, body, start + table.nbytes)
    return xyz_of(table, fields)


def _header(lines: list[str]) -> tuple[str, list[_Element]]:
    """Format and elements of a header.

    Raises:
        ValueError: a line is not understood; it is named.
    """
    form, elements = '', list[_Element]()
    for line in lines:
        match line.split():
            case ['format', name, *_]:
                form = name
            case ['element', name, count]:
                elements.append(_Element(name, count_of(count, f'element {name}'), []))
            case ['property', 'list', length, kind, name] if elements:
                elements[-1].properties.append(_Property(name, _type(kind), _type(length)))
            case ['property', kind, name] if elements:
                elements[-1].properties.append(_Property(name, _type(kind)))
            case ['element' | 'property' | 'format', *_]:
                raise ValueError(f'header line not understood: {line[:60]!r}')
    if form not in _ORDERS:
        raise ValueError(f'expected format {", ".join(_ORDERS)}, found {form[:30] or "none"!r}')
    return form, elements


def _type(name: str) -> str:
    if name not in _TYPES:
        raise ValueError(f'expected a property type such as float, found {name[:30]!r}')
    return _TYPES[name]


def _skip(body: bytes, start: int, element: _Element, order: str) -> int:
    """Where the rows of an element end.

    Raises:
        ValueError: beyond the end of the file.
    """
    if not element.has_lists:
        size = sum(np.dtype(p.kind).itemsize for p in element.properties)
        end = start + size * element.rows
    else:
        end = start
        for _ in range(element.rows):
            for prop in element.properties:
                size = np.dtype(prop.kind).itemsize
                if prop.length:
                    kind = np.dtype(order + prop.length)
                    piece = body[end : end + kind.itemsize]
                    if len(piece) < kind.itemsize:
                        raise ValueError(f'cut off within the element {element.name}')
                    end += kind.itemsize
                    size *= max(int(np.frombuffer(piece, kind)[0]), 0)
                end += size
            if end > len(body):
                break
    if end > len(body):
        raise ValueError(f'cut off within the element {element.name}')
    return end
