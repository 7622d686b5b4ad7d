# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""HybridReg: registration of scenes with hybrid motion, and the odometry built on it.

Importing this package is cheap, and only training loads torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hybridreg_ros.core.scan import Scan
    from hybridreg_ros.model.register import HybridReg
    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.frontend import HybridOdometry

__all__ = ['HybridOdometry', 'HybridReg', 'OdometryConfig', 'Scan']

_HOMES = {
    'HybridReg': 'hybridreg_ros.model.register',
    'HybridOdometry': 'hybridreg_ros.odometry.frontend',
    'OdometryConfig': 'hybridreg_ros.odometry.config',
    'Scan': 'hybridreg_ros.core.scan',
}


def __getattr__(name: str) -> Any:
    """Load a public name from its home when it is first used (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
