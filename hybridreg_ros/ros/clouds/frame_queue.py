# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bounded queue between the subscription and the worker; every cloud that goes is reported."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

T = TypeVar('T')


class FrameQueue(Generic[T]):
    """First in, first out; `put` never blocks and says what had to go.

    Args:
        depth: items that may wait.
        keep_newest: True drops the oldest waiting item when full, False refuses the new one.
    """

    def __init__(self, depth: int, keep_newest: bool = True) -> None:
        self._items: deque[T] = deque()
        self._condition = threading.Condition()
        self._closed = False
        self.configure(depth, keep_newest)

    def configure(self, depth: int, keep_newest: bool) -> int:
        """Change depth and policy; returns how many waiting items had to go."""
        with self._condition:
            self._depth, self._keep_newest = depth, keep_newest
            surplus = max(len(self._items) - depth, 0)
            for _ in range(surplus):
                self._items.popleft() if keep_newest else self._items.pop()
            return surplus

    def put(self, item: T) -> int:
        """Add an item; returns the number of items dropped for it (0 or 1)."""
        with self._condition:
            if self._closed:
                return 1
            dropped = 0
            if len(self._items) >= self._depth:
                if not self._keep_newest:
                    return 1
                self._items.popleft()
                dropped = 1
            self._items.append(item)
            self._condition.notify()
            return dropped

    def get(self) -> T | None:
        """Wait for the next item; None once the queue is closed and empty."""
        with self._condition:
            self._condition.wait_for(lambda: self._items or self._closed)
            return self._items.popleft() if self._items else None

    def shed(self) -> int:
        """Drop the oldest beyond half of what may wait; returns the number of items."""
        with self._condition:
            count = max(len(self._items) - (self._depth + 1) // 2, 0)
            for _ in range(count):
                self._items.popleft()
            return count

    def clear(self) -> int:
        """Drop what waits; returns the number of items."""
        with self._condition:
            count = len(self._items)
            self._items.clear()
            return count

    def close(self) -> int:
        """Drop what waits, wake the worker and refuse new items."""
        with self._condition:
            count = len(self._items)
            self._items.clear()
            self._closed = True
            self._condition.notify_all()
            return count

    @property
    def half_full(self) -> bool:
        """Whether half of what may wait does."""
        return 2 * len(self._items) >= self._depth

    def __len__(self) -> int:
        """Number of waiting items."""
        return len(self._items)
