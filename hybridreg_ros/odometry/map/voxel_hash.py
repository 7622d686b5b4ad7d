# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels of voxel keys and of hash tables of them."""

from __future__ import annotations

import numpy as np

from hybridreg_ros.core.jit import compiled, compiled_inline

HALF_SPAN = 1 << 20
"""Voxel indices must lie in (-HALF_SPAN, HALF_SPAN): 21 bits per axis in one int64 key."""
EMPTY = -1

_HASH = -7046029254386353131
_BLOCK = ~((3 << 42) | (3 << 21) | 3)
"""The bits of a key that name the block of 4x4x4 voxels it lies in."""


@compiled_inline
def _first_slot(key, mask):  # type: ignore[no-untyped-def]
    """Where the search for a key begins: voxels of one block lie side by side in memory."""
    own = ((key >> 38) & 48) | ((key >> 19) & 12) | (key & 3)
    return (((((key & _BLOCK) * _HASH) >> 40) << 6) | own) & mask


@compiled_inline
def voxel_key(x, y, z, inverse_size):  # type: ignore[no-untyped-def]
    """Key of the voxel that holds a point (int64), or EMPTY when it lies outside the grid."""
    i = int(np.floor(x * inverse_size)) + HALF_SPAN
    j = int(np.floor(y * inverse_size)) + HALF_SPAN
    k = int(np.floor(z * inverse_size)) + HALF_SPAN
    limit = 2 * HALF_SPAN
    if i <= 0 or j <= 0 or k <= 0 or i >= limit - 1 or j >= limit - 1 or k >= limit - 1:
        return EMPTY
    return (i << 42) | (j << 21) | k


@compiled
def empty_table(count):  # type: ignore[no-untyped-def]
    """Keys (C,) int64, all `EMPTY`, and values (C,) int32 of a hash table for `count` entries."""
    capacity = 16
    while capacity < 2 * count:
        capacity *= 2
    return np.full(capacity, EMPTY, np.int64), np.zeros(capacity, np.int32)


@compiled_inline
def find_slot(table, key):  # type: ignore[no-untyped-def]
    """Slot of a key in the open-addressing table (C,), or the free slot where it belongs."""
    mask = len(table) - 1
    slot = ((key * _HASH) >> 40) & mask
    while table[slot] != EMPTY and table[slot] != key:
        slot = (slot + 1) & mask
    return slot


@compiled_inline
def find_voxel(key, slots, voxels):  # type: ignore[no-untyped-def]
    """Number of the voxel with a key in a table that holds numbers only, or -1.

    Args:
        key: int64.
        slots: (C,) int32 numbers of voxels, -1 = free, C a power of two.
        voxels: (V,) of a type with a `key`, int64.
    """
    mask = len(slots) - 1
    slot = _first_slot(key, mask)
    while slots[slot] >= 0 and voxels[slots[slot]].key != key:
        slot = (slot + 1) & mask
    return slots[slot]


@compiled_inline
def add_voxel(number, slots, voxels):  # type: ignore[no-untyped-def]
    """Put a voxel that is not in the table of `find_voxel` into it."""
    mask = len(slots) - 1
    slot = _first_slot(voxels[number].key, mask)
    while slots[slot] >= 0:
        slot = (slot + 1) & mask
    slots[slot] = number
