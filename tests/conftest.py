# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fixtures shared by all tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

SHARED_DATA = Path(__file__).resolve().parents[2] / 'shared' / 'data'


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed."""
    return np.random.default_rng(7)


@pytest.fixture
def shared_data() -> Path:
    """Folder of real recordings; the test is skipped where they are not there."""
    if not SHARED_DATA.is_dir():
        pytest.skip('real recordings (../shared/data) are not here')
    return SHARED_DATA
