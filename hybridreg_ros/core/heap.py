# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The heap of the C library: one for all threads, and its free part back to the system."""

from __future__ import annotations

import ctypes
import os
from typing import Any

_ARENA_MAX = -8
"""Number by which `mallopt` of the GNU C library knows M_ARENA_MAX (malloc.h)."""


def one_heap() -> None:
    """Let all threads of this process take memory from one heap; for a process to do first.

    The C library gives each thread a heap of its own, of which `give_back` leaves the end: threads
    that come and go, as in a registration, grow them for long. Does nothing where the library is
    not GNU's, or where MALLOC_ARENA_MAX in the environment says how many heaps there may be.
    """
    allow = None if 'MALLOC_ARENA_MAX' in os.environ else _c_function('mallopt')
    if allow is not None:
        allow(_ARENA_MAX, 1)


def give_back() -> None:
    """Give the free part of the heap back to the system, where the C library is GNU's.

    It takes a few ms where much is free: for after work that takes long and much memory. Without
    it the heap grows, since small values that stay come to lie between large ones that go.
    """
    trim = _c_function('malloc_trim')
    if trim is not None:
        trim(0)


def _c_function(name: str) -> Any:
    """A function of the C library, None if it has none of that name."""
    return getattr(ctypes.CDLL(None), name, None)
