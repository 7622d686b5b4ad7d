# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Arrays in pages of their own."""

from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.core.pages import resident_mb, zeros


@pytest.mark.parametrize('shape', [(), 0, 7, (5, 3), (0, 4)])
@pytest.mark.parametrize('dtype', [np.int8, np.float32, np.int64])
def test_it_is_an_array_of_zeros(shape: int | tuple[int, ...], dtype: type) -> None:
    found, expected = zeros(shape, dtype), np.zeros(shape, dtype)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, expected)
    found[...] = 1
    assert (found == 1).all()


def test_memory_is_taken_when_written_and_given_back_when_let_go() -> None:
    rows, before = 8_000_000, resident_mb()
    large = zeros((rows, 2), np.float32)
    assert resident_mb() - before < 10.0
    large[:] = 1.0
    assert resident_mb() - before > 60.0
    del large
    assert resident_mb() - before < 10.0


def test_sparse_values_take_little_memory() -> None:
    before = resident_mb()
    sparse = zeros((200, 1 << 18), np.int32)
    sparse[:, 0] = 1
    assert sparse.nbytes > 2e8
    assert resident_mb() - before < 10.0
