# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Memory that goes back to the system: arrays in pages of their own."""

from __future__ import annotations

import mmap
import resource
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray


def zeros(shape: int | tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array of zeros in pages of its own; those never written to take no memory.

    An array of numpy's that grows by being copied leaves a hole in the heap, which the C library
    keeps for later.

    Args:
        shape: of the array.
        dtype: of its values.
    """
    size = max(1, int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize)
    pages = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    return np.ndarray(shape, dtype, buffer=pages)


def paged(array: NDArray[Any]) -> NDArray[Any]:
    """A copy of an array of any shape in pages of its own, for what is kept for long."""
    copy = zeros(array.shape, array.dtype)
    copy[...] = array
    return copy


def has_pages(array: NDArray[Any]) -> bool:
    """Whether an array lies in pages that `zeros` made."""
    owner: Any = array
    while isinstance(owner, np.ndarray):
        owner = owner.base
    return isinstance(owner.obj if isinstance(owner, memoryview) else owner, mmap.mmap)


def resident_mb() -> float:
    """Resident memory of this process, MB (10^6 bytes; Linux)."""
    pages = int(Path('/proc/self/statm').read_text('ascii').split()[1])
    return pages * resource.getpagesize() / 1e6


def peak_mb() -> float:
    """Largest resident memory of this process so far, MB (10^6 bytes; Linux)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
