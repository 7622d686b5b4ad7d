# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Calibration of confidence and covariance: fitted by a command, kept beside this file as JSON."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping

PACKAGED = Path(__file__).parent / 'calibration.json'
KINDS = ('depth', 'lidar')
FEATURES = ('consistent', 'before', 'weakness')
"""Fields of `confidence.Evidence` that the logistic model reads."""


@dataclass(frozen=True)
class Calibration:
    """What was fitted on the development suite.

    Attributes:
        bias: of the logistic model of P(pose right).
        weights: one per feature of FEATURES.
        covariance_scale: by kind of sensor (depth, lidar), the factor on the inverse information
            that makes step errors consistent.
        provenance: how it was fitted.
    """

    bias: float
    weights: Mapping[str, float]
    covariance_scale: Mapping[str, float]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check names and values.

        Raises:
            ConfigError: a feature is missing or unknown, or a value is not finite.
        """
        if set(self.weights) != set(FEATURES):
            raise ConfigError(
                f'calibration: expected weights of {", ".join(FEATURES)}, found '
                f'{", ".join(self.weights)}'
            )
        if set(self.covariance_scale) != set(KINDS):
            raise ConfigError(
                f'calibration: expected covariance scales of {", ".join(KINDS)}, found '
                f'{", ".join(self.covariance_scale)}'
            )
        values = [self.bias, *self.weights.values(), *self.covariance_scale.values()]
        if not all(math.isfinite(v) for v in values) or min(self.covariance_scale.values()) <= 0.0:
            raise ConfigError(
                'calibration: expected finite numbers and positive covariance scales'
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            'confidence': {'bias': self.bias, 'weights': dict(self.weights)},
            'covariance_scale': dict(self.covariance_scale),
            'provenance': dict(self.provenance),
        }


def read(path: Path) -> Calibration:
    """Calibration from a file that `hybridreg replay --suite dev --fit FILE` wrote.

    Raises:
        ConfigError: missing, or not such a file.
    """
    try:
        values = json.loads(path.read_text('utf-8'))
        return Calibration(
            float(values['confidence']['bias']),
            {str(k): float(v) for k, v in values['confidence']['weights'].items()},
            {str(k): float(v) for k, v in values['covariance_scale'].items()},
            values.get('provenance', {}),
        )
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f'cannot read the calibration {path}: {error}') from None


@cache
def packaged() -> Calibration:
    """The calibration that this package ships."""
    return read(PACKAGED)
