# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is kept for long lies in pages of its own, and is the same."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros import HybridReg
from hybridreg_ros.core.nested import mapped
from hybridreg_ros.core.pages import has_pages
from hybridreg_ros.model.budget import Budget
from hybridreg_ros.model.compact_memory import compacted
from hybridreg_ros.model.geometry.grid import Grid
from hybridreg_ros.model.geometry.pyramid import build_pyramid
from hybridreg_ros.model.pose.verify import view_of
from hybridreg_ros.odometry.keyframes import Keyframe
from hybridreg_ros.odometry.network_branch import LearnedBranch, load

if TYPE_CHECKING:
    from hybridreg_ros.model.reference.network import HybridRegNet


def arrays(value: Any) -> list[np.ndarray]:
    found: list[np.ndarray] = []

    def note(leaf: Any) -> None:
        if isinstance(leaf, np.ndarray):
            found.append(leaf)

    mapped(value, note)
    return found


def lie_together(found: list[np.ndarray]) -> bool:
    """Whether arrays fill one stretch of memory."""
    places = {(a.ctypes.data, a.ctypes.data + a.nbytes) for a in found}
    stretch = max(end for _, end in places) - min(start for start, _ in places)
    return stretch <= sum(end - start + 63 for start, end in places)


def test_values_stay_and_get_pages(compact_net: HybridRegNet, room: np.ndarray) -> None:
    pyramid = build_pyramid(room, 0.05, compact_net.config)
    before = compact_net.for_use().encode(pyramid), view_of(pyramid)
    after = compacted(before)
    pairs = list(zip(arrays(before), arrays(after), strict=True))
    assert len(pairs) > 20
    for a, b in pairs:
        assert (a.dtype, a.shape) == (b.dtype, b.shape)
        np.testing.assert_array_equal(a, b)
        assert b.ctypes.data % 64 == 0
    assert lie_together([b for a, b in pairs if not has_pages(a)])
    assert has_pages(Grid.build(room, 1.0).nearest)
    assert after[1].grid.nearest is before[1].grid.nearest


def test_arrays_that_share_memory_do_so_afterwards() -> None:
    array, other = np.arange(3000.0), np.arange(3000.0)
    first, second, third = compacted((array, array[:], other))
    assert first.ctypes.data == second.ctypes.data
    assert not np.shares_memory(first, third)
    np.testing.assert_array_equal(first, array)
    np.testing.assert_array_equal(third, other)
    first[0] = 7.0
    assert array[0] == 0.0


def test_strided_empty_and_other_values_are_left() -> None:
    strided = np.zeros((40, 40))[:, ::2]
    for value in (strided, np.zeros(0), 3.0, None, 'name'):
        assert compacted(value) is value


def test_the_cloud_of_a_keyframe_is_compacted(compact_net: HybridRegNet, room: np.ndarray) -> None:
    registrar = load(HybridReg(compact_net.config, compact_net))
    assert registrar is not None
    branch = LearnedBranch(registrar, 2)
    scan = branch.encode(room, Budget())
    branch.adopt(Keyframe(0, 0, np.eye(4), room), scan)
    (encoded,) = branch._keyframes.values()
    grids = encoded.view.grid.nearest, encoded.view.wide.nearest
    kept = [a for a in arrays(encoded) if not any(a is g for g in grids) and a.size]
    assert len(kept) > 20
    assert lie_together(kept)
