# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Arrays in pages of their own."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from hybridreg_ros.core.heap import give_back, one_heap
from hybridreg_ros.core.pages import has_pages, paged, resident_mb, zeros


@pytest.mark.parametrize('shape', [(), 0, 7, (5, 3), (0, 4)])
@pytest.mark.parametrize('dtype', [np.int8, np.float32, np.int64])
def test_it_is_an_array_of_zeros(shape: int | tuple[int, ...], dtype: type) -> None:
    found = zeros(shape, dtype)
    expected: np.ndarray = np.zeros(shape, dtype)
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


def test_a_copy_in_pages_of_its_own() -> None:
    array = np.arange(12.0).reshape(3, 4)[:, ::2]
    copy = paged(array)
    np.testing.assert_array_equal(copy, array)
    assert copy.dtype == array.dtype
    assert not np.shares_memory(copy, array)
    assert has_pages(copy)
    assert has_pages(copy[1:].view(np.int64).reshape(-1))
    assert not has_pages(array)
    assert not has_pages(np.frombuffer(b'12345678'))


def test_freed_values_between_kept_ones_go_back_to_the_system() -> None:
    kept, gone = [], []
    for _ in range(2_000):
        gone.append(np.ones(15_000, np.uint8).repeat(2))
        kept.append(np.ones(1_200, np.uint8).copy())
    del gone
    before = resident_mb()
    give_back()
    assert before - resident_mb() > 30.0
    assert all(k.all() for k in kept)


@pytest.mark.parametrize(('given', 'heaps'), [(None, 1), ('2', 2), ('unset', 4)])
def test_threads_share_one_heap_unless_told(given: str | None, heaps: int) -> None:
    """Four threads hold memory at a time; each heap is one writable mapping of the process."""
    env = {k: v for k, v in os.environ.items() if k != 'MALLOC_ARENA_MAX'}
    env |= {'MALLOC_ARENA_MAX': given} if given not in {None, 'unset'} else {}
    code = (
        'import ctypes, threading\n'
        'from hybridreg_ros.core.heap import one_heap\n'
        f'{"" if given == "unset" else "one_heap()"}\n'
        'c = ctypes.CDLL(None)\n'
        'c.malloc.restype, c.malloc.argtypes = ctypes.c_size_t, [ctypes.c_size_t]\n'
        'together, found = threading.Barrier(4), []\n'
        'def take():\n'
        '    found.append(c.malloc(4000))\n'
        '    together.wait()\n'
        'threads = [threading.Thread(target=take) for _ in range(4)]\n'
        '[t.start() for t in threads]; [t.join() for t in threads]\n'
        'starts = [int(m.split("-")[0], 16) for m in open("/proc/self/maps") if " rw-p " in m]\n'
        'print(len({max(s for s in starts if s <= place) for place in found}))'
    )
    done = subprocess.run(
        [sys.executable, '-c', code], env=env, capture_output=True, text=True, check=True
    )
    assert int(done.stdout) == heaps


def test_nothing_is_given_back_where_the_c_library_cannot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('ctypes.CDLL', lambda name: object())
    give_back()
    one_heap()
