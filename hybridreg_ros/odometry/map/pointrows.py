# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numba kernels that hand out the rows in which the points of a voxel lie side by side.

Most voxels hold a few points, a few hold many. A voxel starts with one row and moves to a run half
as long again when that is full; the run that it leaves goes to the next voxel that asks for one of
that length. So the arrays hold hardly more rows than there are points, and those of what a map
forgets are used again.
"""

from __future__ import annotations

import numpy as np

from hybridreg_ros.core.jit import compiled


@compiled
def none_taken(longest):  # type: ignore[no-untyped-def]
    """Free rows (F,) int32 while none is in use: heads of chains, and the first row never taken.

    Args:
        longest: rows of the longest run. Entry n is the first row of a run of n that was given
            back, -1 = there is none; the last entry is the first row that was never taken.
    """
    free = np.full(longest + 2, -1, np.int32)
    free[-1] = 0
    return free


@compiled
def longer(room, longest):  # type: ignore[no-untyped-def]
    """Rows of the next longer run: half as many again."""
    return min(room + max(1, room // 2), longest)


@compiled
def take(room, free, following):  # type: ignore[no-untyped-def]
    """First row of a run of so many rows, or -1 when the arrays are full.

    Args:
        room: rows wanted.
        free: (F,) as `none_taken` gives it, changed in place.
        following: (P,) int32, one per row; of a free run, its first holds the next run's.
    """
    row = free[room]
    if row >= 0:
        free[room] = following[row]
        return row
    row = free[-1]
    if row + room > len(following):
        return -1
    free[-1] = row + room
    return row


@compiled
def give_back(row, room, free, following):  # type: ignore[no-untyped-def]
    """Let a run of `room` rows from `row` on be taken again; other arguments as in `take`."""
    following[row] = free[room]
    free[room] = row
