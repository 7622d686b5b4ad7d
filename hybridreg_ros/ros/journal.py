# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Journal: every line of the process through the node's logger, few of each kind."""

from __future__ import annotations

import logging
import threading
import time
import traceback
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

PERIOD_S = 5.0
"""Of one kind, a line is written at most so often."""

_PACKAGE = 'hybridreg_ros'


class Journal(logging.Handler):
    """Writes lines to a ROS logger; what comes too often is counted and said with the next line.

    While it is open, Python's warnings, the library's own log and errors that end a thread take
    the same way, so that they reach /rosout too.
    """

    def __init__(self, logger: Any, now: Callable[[], float] = time.monotonic) -> None:
        """Say where lines go.

        Args:
            logger: of the node.
            now: clock, s.
        """
        super().__init__()
        self._logger, self._now = logger, now
        self._kinds: dict[str, tuple[float, int]] = {}
        self._guard = threading.Lock()

    def open(self) -> Journal:
        """Take over what the library, Python and ending threads have to say."""
        for name in (_PACKAGE, 'py.warnings'):
            log = logging.getLogger(name)
            log.addHandler(self)
            log.propagate = False
        logging.captureWarnings(True)
        threading.excepthook = self.of_thread
        return self

    def shut(self) -> None:
        """Give all that back."""
        for name in (_PACKAGE, 'py.warnings'):
            log = logging.getLogger(name)
            log.removeHandler(self)
            log.propagate = True
        logging.captureWarnings(False)
        threading.excepthook = threading.__excepthook__

    def warn(self, kind: str, text: str) -> None:
        """Log a warning 'kind: text'."""
        held = self._held(kind)
        if held is not None:
            self._logger.warning(f'{kind}: {text}{held}')

    def emit(self, record: logging.LogRecord) -> None:
        """Log a record of the library; its kind is its text without what is filled in."""
        held = self._held(str(record.msg))
        if held is None:
            return
        line = ' '.join(record.getMessage().split()) + held
        if record.levelno >= logging.WARNING:
            self._logger.warning(line)
        else:
            self._logger.info(line)

    def of_thread(self, arguments: threading.ExceptHookArgs) -> None:
        """Log the traceback of an error that ended a thread."""
        held = self._held(arguments.exc_type.__name__)
        if held is not None:
            lines = traceback.format_exception(
                arguments.exc_type, arguments.exc_value, arguments.exc_traceback
            )
            self._logger.error(f'internal error{held}\n{"".join(lines)}')

    def _held(self, kind: str) -> str | None:
        """None when it is too early for a line of this kind; else how many were held back."""
        with self._guard:
            now, (last, held) = self._now(), self._kinds.get(kind, (-PERIOD_S, 0))
            if now - last < PERIOD_S:
                self._kinds[kind] = last, held + 1
                return None
            self._kinds[kind] = now, 0
        return f' (and {held} more of this kind)' if held else ''
