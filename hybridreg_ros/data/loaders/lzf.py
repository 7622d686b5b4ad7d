# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""LZF decompression, as PCD files use it."""

from __future__ import annotations


def decompress(packed: bytes, size: int) -> bytes:
    """Decompress LZF data.

    A control byte below 32 announces that many plus one literal bytes; otherwise its upper three
    bits hold the length of a repetition (7 = one more length byte follows), and its lower five
    bits with the next byte the distance back.

    Args:
        packed: compressed bytes.
        size: number of bytes they stand for.

    Raises:
        ValueError: the data are damaged.

    Examples:
        >>> decompress(bytes([2, 97, 98, 99, 0x80, 2]), 9)
        b'abcabcabc'
    """
    out = bytearray()
    place = 0
    try:
        while place < len(packed):
            control = packed[place]
            place += 1
            if control < 32:
                out += packed[place : place + control + 1]
                place += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += packed[place]
                place += 1
            start = len(out) - ((control & 31) << 8) - packed[place] - 1
            place += 1
            if start < 0:
                raise ValueError('LZF data refer to bytes before their beginning')
            piece, length = bytes(out[start : start + length + 2]), length + 2
            while len(piece) < length:  # it reaches into itself
                piece += piece
            out += piece[:length]
            if len(out) > size:
                raise ValueError(f'LZF data hold more than {size} bytes')
    except IndexError:
        raise ValueError('LZF data are cut off') from None
    if len(out) != size:
        raise ValueError(f'LZF data hold {len(out)} bytes, expected {size}')
    return bytes(out)
