# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C between two frames instead of inside one, so that every output stays whole."""

from __future__ import annotations

import logging
import signal
import threading
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from types import TracebackType

logger = logging.getLogger(__name__)


class StopRequest:
    """While active, the first SIGINT or SIGTERM only sets a flag; the second one interrupts.

    Outside the main thread, where signals cannot be taken, it does nothing.
    """

    def __init__(self) -> None:
        self.requested = False
        self._previous: dict[int, Any] = {}

    def __call__(self) -> bool:
        """True once a stop was asked for."""
        return self.requested

    def _handle(self, number: int, frame: Any) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        logger.warning(
            'stopping after this frame; results are kept (press Ctrl-C again to stop at once)'
        )

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._previous[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._previous.clear()
