# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Exceptions: one root, one subclass per failure that a caller can act on."""

from importlib.util import find_spec


class HybridRegError(Exception):
    """Root of every error this package raises on purpose; its text is one readable line."""


class ConfigError(HybridRegError):
    """A setting is unknown, has the wrong type or lies outside its range."""


class PointCloudError(HybridRegError):
    """A point cloud or PointCloud2 message cannot be used as given."""


class FileFormatError(HybridRegError):
    """A data file (cloud, image, trajectory, data set) is missing, truncated or malformed."""


class BagError(HybridRegError):
    """A bag is missing, broken, or lacks the topic that was asked for."""


class WeightsError(HybridRegError):
    """A weights file is missing, truncated, foreign, or does not fit the model."""


class RegistrationError(HybridRegError):
    """Two clouds cannot be registered at all (too few points, no extent)."""


class DependencyError(HybridRegError):
    """An optional package is needed for this call and is not installed."""


def require(what: str, extra: str, *modules: str) -> None:
    """Find out before the work begins whether what it needs is there.

    Args:
        what: needs the modules, such as 'reports' or '--rerun'.
        extra: of this package, that installs them.
        modules: names of top-level modules.

    Raises:
        DependencyError: one of them is not installed.
    """
    if missing := [name for name in modules if find_spec(name) is None]:
        install = f"pip install 'hybridreg_ros[{extra}]'"
        raise DependencyError(f'{what} needs {", ".join(missing)}: {install}')
