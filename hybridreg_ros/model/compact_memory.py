# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is kept of a cloud for long, out of the way of arrays that live for one scan only."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

from hybridreg_ros.core.nested import mapped
from hybridreg_ros.core.pages import has_pages, zeros

_T = TypeVar('_T')
_LINE = 64
"""Bytes at whose multiples arrays start: a line of the cache."""


def compacted(value: _T) -> _T:
    """The same value with its arrays side by side in pages of their own.

    Kept on the heap of the C library, they leave holes between them into which later, larger ones
    do not fit, so that it grows for as long as clouds of different sizes come. What lies in such
    pages already stays, and so does what is no contiguous array. Arrays that share
    their memory do so afterwards.

    Args:
        value: array, or frozen dataclass or tuple of such (`core.nested`).
    """
    places: dict[tuple[int, int], int] = {}
    size = 0

    def place(leaf: Any) -> None:
        nonlocal size
        if _movable(leaf) and _memory(leaf) not in places:
            places[_memory(leaf)] = size
            size += -(-leaf.nbytes // _LINE) * _LINE

    def moved(leaf: Any) -> Any:
        if not _movable(leaf):
            return leaf
        start = places[_memory(leaf)]
        copy = room[start : start + leaf.nbytes].view(leaf.dtype).reshape(leaf.shape)
        copy[...] = leaf
        return copy

    mapped(value, place)
    room = zeros(size, np.uint8)
    return mapped(value, moved)  # type: ignore[no-any-return]


def _movable(leaf: Any) -> bool:
    """Whether a leaf is an array that does not stay where it is."""
    array = isinstance(leaf, np.ndarray) and leaf.flags.c_contiguous and leaf.nbytes > 0
    return array and not has_pages(leaf)


def _memory(array: np.ndarray) -> tuple[int, int]:
    """Where the values of an array lie: address and bytes."""
    return array.ctypes.data, array.nbytes
