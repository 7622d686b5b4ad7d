# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Values that hold others: frozen dataclasses and tuples."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable


def mapped(value: Any, change: Callable[[Any], Any]) -> Any:
    """The same nested dataclasses and tuples, each leaf replaced by what a function makes of it.

    Args:
        value: leaf, frozen dataclass or plain tuple of such; anything else is a leaf.
        change: takes a leaf, in the order of the fields, and returns what stands in its place.
    """
    if is_dataclass(value) and not isinstance(value, type):
        parts = {f.name: mapped(getattr(value, f.name), change) for f in fields(value)}
        return replace(value, **parts)
    if type(value) is tuple:
        return tuple(mapped(v, change) for v in value)
    return change(value)
