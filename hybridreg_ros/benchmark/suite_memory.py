# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Resident memory over looped sequences, as `scripts/memory_report.py` leaves it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core.errors import FileFormatError

if TYPE_CHECKING:
    from pathlib import Path

NAME = 'memory.json'
"""File in the folder of the results."""
WARM_STEPS = 100
"""Steps after which growth counts: by then libraries are loaded and kernels compiled."""
STEPS = 10_000
"""Steps of a loop that counts in the table of goals."""


def read(folder: Path) -> dict[str, dict[str, Any]]:
    """What was measured by sequence: `resident_mb` by step, and `steps`; empty without a file.

    Raises:
        FileFormatError: the file is something else.
    """
    path = folder / NAME
    if not path.exists():
        return {}
    try:
        rows: dict[str, dict[str, Any]] = json.loads(path.read_text('utf-8'))
        for row in rows.values():
            growth_mb(row)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileFormatError(
            f'{path}: expected the figures of scripts/memory_report.py by sequence, found '
            f'something else ({type(error).__name__}: {error}): remove it and measure again'
        ) from error
    return rows


def growth_mb(row: dict[str, Any]) -> float:
    """By how many MB a loop grew from step `WARM_STEPS` to its last, one value of `read`."""
    at = row['resident_mb']
    return float(at[str(row['steps'] - 1)]) - float(at[str(WARM_STEPS)])
