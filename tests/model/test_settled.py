# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is kept for long lies in pages of its own, and is the same."""

from __future__ import annotations

import mmap
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from hybridreg_ros import HybridReg
from hybridreg_ros.model.grid import Grid
from hybridreg_ros.model.pyramid import build_pyramid
from hybridreg_ros.model.settled import settled
from hybridreg_ros.model.verify import view_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hybridreg_ros.model.network import HybridRegNet

LARGE = 1 << 16


def arrays(value: Any) -> Iterator[np.ndarray]:
    if isinstance(value, torch.Tensor):
        yield value.numpy()
    elif isinstance(value, np.ndarray):
        yield value
    elif is_dataclass(value):
        for f in fields(value):
            yield from arrays(getattr(value, f.name))
    elif isinstance(value, tuple):
        for v in value:
            yield from arrays(v)


def is_in_own_pages(array: np.ndarray) -> bool:
    while isinstance(array.base, np.ndarray):
        array = array.base
    owner = array.base
    return isinstance(owner.obj if isinstance(owner, memoryview) else owner, mmap.mmap)


def test_values_stay_and_large_ones_get_pages(
    compact_net: HybridRegNet, room: np.ndarray
) -> None:  # fmt: skip
    pyramid = build_pyramid(room, 0.05, compact_net.config)
    with torch.no_grad():
        before = compact_net.encode(pyramid), view_of(pyramid)
    after = settled(before)
    pairs = list(zip(arrays(before), arrays(after), strict=True))
    large = [b for a, b in pairs if a.nbytes >= LARGE]
    assert len(large) >= 4
    for a, b in pairs:
        assert (a.dtype, a.shape) == (b.dtype, b.shape)
        np.testing.assert_array_equal(a, b)
    assert settled(before[1].grid) is before[1].grid
    tensors = [v for v in (after[0].pyramid.geometry, after[0].fine_features) if v.nbytes >= LARGE]
    assert tensors
    assert all(v.untyped_storage().data_ptr() % mmap.PAGESIZE == 0 for v in tensors)
    assert is_in_own_pages(Grid.build(room, 1.0).nearest)


def test_small_strided_and_other_values_are_left() -> None:
    small, strided = np.zeros(10), np.zeros((400, 400))[:, ::2]
    for value in (small, strided, torch.from_numpy(strided), 3.0, None, 'name'):
        assert settled(value) is value


def test_clouds_are_settled_when_encoded(compact_net: HybridRegNet, room: np.ndarray) -> None:
    encoded = HybridReg(compact_net.config, compact_net).encode(room, 0.05).encoding
    kept = [v for v in (encoded.pyramid.geometry, encoded.fine_features) if v.nbytes >= LARGE]
    assert kept
    assert all(v.untyped_storage().data_ptr() % mmap.PAGESIZE == 0 for v in kept)
