# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What PLY and PCD files share: a text header, then rows of named values as text or binary."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.pointcloud2 import coordinates, unique_names

logger = logging.getLogger(__name__)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


def split_header(data: bytes, end: bytes) -> tuple[list[str], bytes]:
    """Header lines up to and including the line that starts with `end`, and the rest.

    Raises:
        ValueError: there is no such line.
    """
    place = data.find(end)
    stop = data.find(b'\n', place + 1)
    if place < 0 or stop < 0:
        raise ValueError(f'no {end.decode().strip()} line: expected a header that ends with it')
    return data[:stop].decode('ascii', 'replace').splitlines(), data[stop + 1 :]


def count_of(text: str, what: str) -> int:
    """A number of rows.

    Raises:
        ValueError: it is no number, or negative.
    """
    if not (text.isascii() and text.isdigit()):
        raise ValueError(f'{what}: expected a number of points, found {text[:30]!r}')
    return int(text)


def axes_of(names: Sequence[str]) -> list[int]:
    """Columns of x, y and z, in small or capital letters; of doubled names the first.

    Raises:
        ValueError: one is missing.
    """
    found, missing = coordinates(names)
    if missing:
        raise ValueError(f'no field {", ".join(missing)}; found {", ".join(names) or "none"}')
    return [list(names).index(name) for name in found]


def ascii_rows(
    body: bytes, names: Sequence[str], count: int, skipped: int = 0
) -> NDArray[np.float64]:
    """Coordinates (count, 3) of lines of numbers, after some lines that are skipped.

    Raises:
        ValueError: lines are missing, too short, or hold something else.
    """
    lines = body.decode('ascii', 'replace').splitlines()[skipped : skipped + count]
    if len(lines) < count:
        raise ValueError(f'cut off: {count} points announced, {len(lines)} found')
    columns = axes_of(names)
    table = np.empty((count, 3))
    for number, line in enumerate(lines):
        words = line.split()
        try:
            table[number] = [float(words[k]) for k in columns]
        except (IndexError, ValueError):
            raise ValueError(
                f'point {number}: expected {len(names)} numbers, found {line[:60]!r}'
            ) from None
    return table


def records(body: bytes, names: Sequence[str], kinds: Sequence[Any], count: int) -> NDArray[Any]:
    """Structured array (count,) of binary rows; doubled names are numbered.

    Args:
        body: rows, maybe with more behind.
        names: of the fields.
        kinds: dtype of each, with its byte order.
        count: rows.

    Raises:
        ValueError: the bytes are too few.
    """
    layout = np.dtype(list(zip(unique_names(names), kinds, strict=True)))
    if len(body) < count * layout.itemsize:
        raise ValueError(
            f'cut off: {count} points need {count * layout.itemsize} bytes, found {len(body)}'
        )
    if not layout.itemsize:
        axes_of(names)
    return np.frombuffer(body, dtype=layout, count=count)


def tell_of_more(what: str, body: bytes, end: int, lines: bool = False) -> None:
    """Warn that something follows the last point: a damaged header may announce too few.

    Args:
        what: name of the file.
        body: all after the header.
        end: where the points end: a number of bytes, or of lines.
        lines: whether it is that of lines.
    """
    rest = (body.split(b'\n', end)[end:] or [b''])[0].strip() if lines else body[end:]
    if rest:
        logger.warning('%s: %d bytes follow the last point that is announced', what, len(rest))


def xyz_of(table: NDArray[Any], names: Sequence[str]) -> NDArray[np.float64]:
    """Coordinates (N, 3) of a structured array; a field of several values gives its first.

    Raises:
        ValueError: one of x y z is missing.
    """
    columns = [table[(table.dtype.names or ())[k]] for k in axes_of(names)]
    first = [c if c.ndim == 1 else c.reshape(len(c), -1)[:, 0] for c in columns]
    return np.stack([c.astype(np.float64) for c in first], axis=1)
