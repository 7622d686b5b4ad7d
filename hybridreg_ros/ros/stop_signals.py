# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM end the process with 0 in bounded time, whatever it does at that moment.

A handler would run in the main thread, as an exception or only once a long call returns. Here
both signals are blocked in every thread, and a thread of its own waits for them.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from collections.abc import Callable

GRACE_S = 0.8
"""Time for an orderly end; the process leaves without one when it takes longer."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def leave(code: int) -> NoReturn:
    """End the process at once: nothing is unwound and no thread is waited for."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


class StopSignals:
    """Waits for the signals as long as the context manager is open.

    It must be opened before other threads start: they inherit which signals are blocked. A second
    signal changes nothing.

    Attributes:
        asked: True once a signal came.
    """

    def __init__(self) -> None:
        self.asked = False
        self._lock = threading.Lock()
        self._wake: Callable[[], object] | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._wait, name='signals', daemon=True)

    def __enter__(self) -> StopSignals:
        """Block the signals and wait for them from now on.

        A script that starts a process in the background has it ignore SIGINT; here it counts.
        """
        if threading.current_thread() is threading.main_thread():
            for number in _SIGNALS:
                if signal.getsignal(number) is signal.SIG_IGN:
                    signal.signal(number, signal.SIG_DFL)
        self._before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop waiting. After a signal the signals stay blocked: the process is ending."""
        self._ended.set()
        if self._thread.is_alive() and not self.asked:
            signal.pthread_kill(self._thread.ident or 0, signal.SIGTERM)
        self._thread.join(GRACE_S)
        if not self.asked and not signal.sigpending().intersection(_SIGNALS):
            signal.pthread_sigmask(signal.SIG_SETMASK, self._before)

    def end_in_order(self, wake: Callable[[], object]) -> None:
        """From now on a signal leaves `GRACE_S` for an orderly end; before, none is needed.

        Args:
            wake: called in another thread when a signal comes; has the main loop look at `asked`.
        """
        with self._lock:
            self._wake = wake

    def _wait(self) -> None:
        signal.sigwait(_SIGNALS)
        if self._ended.is_set():
            return
        with self._lock:
            self.asked = True
            if self._wake is None:
                leave(0)
            self._wake()
        if not self._ended.wait(GRACE_S):
            leave(0)
