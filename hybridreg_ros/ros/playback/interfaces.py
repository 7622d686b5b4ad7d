# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Message classes by name, for bags whose types are known only when they are opened."""

from __future__ import annotations

import importlib
from typing import Any


def message_class(name: str) -> Any | None:
    """Class of 'package/msg/Type', or None when the package or the type is not installed."""
    package, _, kind = name.partition('/msg/')
    try:
        module = importlib.import_module(f'{package}.msg')
    except ImportError:
        return None
    return getattr(module, kind, None)
