# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Progress bars on stderr."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core.errors import require

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


def bar(total: int | None, text: str, unit: str = 'frame') -> Any:
    """Progress bar on stderr (tqdm); it stays quiet when stderr is not a terminal.

    Raises:
        DependencyError: tqdm is not installed.
    """
    require('a progress bar', 'replay', 'tqdm')
    from tqdm import tqdm

    quiet = not sys.stderr.isatty()
    return tqdm(
        total=total, desc=text, unit=unit, file=sys.stderr, mininterval=5.0 if quiet else 0.1
    )


def progress(
    items: Iterable[Any], total: int | None, text: str, unit: str = 'frame'
) -> Iterator[Any]:
    """Items, with a progress bar."""
    with bar(total, text, unit) as shown:
        for item in items:
            yield item
            shown.update()
