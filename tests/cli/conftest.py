# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tiny bags: a sensor moving through a room of planes, with one moving box and true labels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tiny_bags import write_room_bag

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope='session')
def room_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """12 labelled clouds with ground truth, one bare mcap file; not to be changed."""
    path = tmp_path_factory.mktemp('bags') / 'room.mcap'
    write_room_bag(path)
    return path
