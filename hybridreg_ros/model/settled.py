# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What is kept of a cloud for long, out of the way of tensors that live for one scan only."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import torch

from hybridreg_ros.core.pages import zeros
from hybridreg_ros.model.grid import Grid

_LARGE = 1 << 16
"""Bytes from which an array gets pages of its own; smaller ones leave small holes."""


def settled(value: Any) -> Any:
    """The same value with each large array and tensor in pages of its own (`core/pages.py`).

    Between tensors that are kept the heap of the C library has holes into which later, larger ones
    do not fit, so that it grows for as long as clouds of different sizes come.

    Args:
        value: array, tensor on the CPU, or frozen dataclass or tuple of such; else returned as is.
    """
    if isinstance(value, Grid):  # made in pages of its own
        return value
    if is_dataclass(value) and not isinstance(value, type):
        parts = {f.name: settled(getattr(value, f.name)) for f in fields(value)}
        return replace(value, **parts)
    if type(value) is tuple:
        return tuple(settled(v) for v in value)
    if isinstance(value, torch.Tensor) and not value.is_cuda and value.is_contiguous():
        return value if _is_small(value) else torch.from_numpy(settled(value.numpy()))
    if isinstance(value, np.ndarray) and value.flags.c_contiguous and not _is_small(value):
        copy = zeros(value.shape, value.dtype)
        copy[...] = value
        return copy
    return value


def _is_small(value: torch.Tensor | np.ndarray) -> bool:
    return value.nbytes < _LARGE
