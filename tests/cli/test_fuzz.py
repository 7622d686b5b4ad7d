# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged files of every format through the command line; `scripts/fuzz_loaders.py` says more."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / 'scripts' / 'fuzz_loaders.py'


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize('seed', [101, 102])
def test_damaged_files_are_read_or_refused_in_one_line(seed: int) -> None:
    """In a process of its own: the script limits memory and uses a signal."""
    done = subprocess.run(
        [sys.executable, str(SCRIPT), '--files', '1000', '--seed', str(seed)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
