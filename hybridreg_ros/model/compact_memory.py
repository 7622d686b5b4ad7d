# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is kept of a cloud for long, out of the way of tensors that live for one scan only."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
import torch

from hybridreg_ros.core.nested import mapped
from hybridreg_ros.core.pages import has_pages, zeros

_T = TypeVar('_T')
_LINE = 64
"""Bytes at whose multiples arrays start, as the allocator of torch has it."""


def compacted(value: _T) -> _T:
    """The same value with its arrays and tensors side by side in pages of their own.

    Kept on the heap of the C library, they leave holes between them into which later, larger ones
    do not fit, so that it grows for as long as clouds of different sizes come. What lies in such
    pages already stays, and so does what is no contiguous array on the CPU. Arrays that share
    their memory do so afterwards.

    Args:
        value: array, tensor, or frozen dataclass or tuple of such (`core.nested`).
    """
    places: dict[tuple[int, int], int] = {}
    size = 0

    def place(leaf: Any) -> None:
        nonlocal size
        array = _movable(leaf)
        if array is not None and _memory(array) not in places:
            places[_memory(array)] = size
            size += -(-array.nbytes // _LINE) * _LINE

    def moved(leaf: Any) -> Any:
        array = _movable(leaf)
        if array is None:
            return leaf
        start = places[_memory(array)]
        copy = room[start : start + array.nbytes].view(array.dtype).reshape(array.shape)
        copy[...] = array
        return torch.from_numpy(copy) if isinstance(leaf, torch.Tensor) else copy

    mapped(value, place)
    room = zeros(size, np.uint8)
    return mapped(value, moved)  # type: ignore[no-any-return]


def _movable(leaf: Any) -> np.ndarray | None:
    """The array or tensor as an array, None if it is to stay where it is."""
    if isinstance(leaf, torch.Tensor) and leaf.device.type == 'cpu' and not leaf.requires_grad:
        leaf = leaf.numpy()
    if not isinstance(leaf, np.ndarray) or not leaf.flags.c_contiguous:
        return None
    return None if leaf.nbytes == 0 or has_pages(leaf) else leaf


def _memory(array: np.ndarray) -> tuple[int, int]:
    """Where the values of an array lie: address and bytes."""
    return array.ctypes.data, array.nbytes
