# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fixtures shared by all tests."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

SHARED_DATA = Path(__file__).resolve().parents[2] / 'shared' / 'data'
SCRIPTS = Path(__file__).resolve().parents[1] / 'scripts'


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


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Imports a file of scripts/ by its name, anew."""

    def load(name: str) -> ModuleType:
        monkeypatch.syspath_prepend(str(SCRIPTS))
        monkeypatch.delitem(sys.modules, name, raising=False)
        return import_module(name)

    return load
