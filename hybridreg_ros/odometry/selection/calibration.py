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
_LARGEST_SCORE = 500.0
"""Log odds beyond this overflow."""
EVIDENCE = ('consistent', 'before', 'worst_axis')
"""Attributes of `PoseEvidence` by which poses are judged."""
REPORTED = ('evident', 'unmatched', 'disagreement', 'innovation', 'runner_up')
"""Attributes of `ReportedConfidence` from which it follows."""


@dataclass(frozen=True)
class Logistic:
    """A logistic model of P(pose right).

    Attributes:
        bias: scalar.
        weights: by name of the attribute.
    """

    bias: float
    weights: Mapping[str, float]

    def probability(self, of: object) -> float:
        """P(pose right), [0, 1], of something that has the attributes."""
        score = self.bias + sum(w * getattr(of, name) for name, w in self.weights.items())
        return 1.0 / (1.0 + math.exp(-min(max(score, -_LARGEST_SCORE), _LARGEST_SCORE)))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {'bias': self.bias, 'weights': dict(self.weights)}


@dataclass(frozen=True)
class OdometryCalibration:
    """What was fitted on the development suite.

    Attributes:
        evidence: model by which poses are judged and chosen; its features are EVIDENCE.
        confidence: model of the confidence that is reported; its features are REPORTED.
        covariance_scale: by kind of sensor (depth, lidar), the factor on the inverse information
            that makes step errors consistent.
        provenance: how each of them was fitted.
    """

    evidence: Logistic
    confidence: Logistic
    covariance_scale: Mapping[str, float]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check names and values.

        Raises:
            ConfigError: a feature is missing or unknown, or a value is not finite.
        """
        values = list(self.covariance_scale.values())
        for model, names in ((self.evidence, EVIDENCE), (self.confidence, REPORTED)):
            if set(model.weights) != set(names):
                raise ConfigError(
                    f'calibration: expected weights of {", ".join(names)}, found '
                    f'{", ".join(model.weights)}'
                )
            values += [model.bias, *model.weights.values()]
        if set(self.covariance_scale) != set(KINDS):
            raise ConfigError(
                f'calibration: expected covariance scales of {", ".join(KINDS)}, found '
                f'{", ".join(self.covariance_scale)}'
            )
        if not all(math.isfinite(v) for v in values) or min(self.covariance_scale.values()) <= 0.0:
            raise ConfigError(
                'calibration: expected finite numbers and positive covariance scales'
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            'evidence': self.evidence.to_dict(),
            'confidence': self.confidence.to_dict(),
            'covariance_scale': dict(self.covariance_scale),
            'provenance': dict(self.provenance),
        }


def read(path: Path) -> OdometryCalibration:
    """Calibration from a file that `hybridreg replay --suite dev --fit FILE` wrote.

    Raises:
        ConfigError: missing, or not such a file.
    """
    try:
        values = json.loads(path.read_text('utf-8'))
        return OdometryCalibration(
            _logistic(values['evidence']),
            _logistic(values['confidence']),
            {str(k): float(v) for k, v in values['covariance_scale'].items()},
            values.get('provenance', {}),
        )
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f'cannot read the calibration {path}: {error}') from None


def _logistic(values: Mapping[str, Any]) -> Logistic:
    weights = {str(k): float(v) for k, v in values['weights'].items()}
    return Logistic(float(values['bias']), weights)


@cache
def packaged() -> OdometryCalibration:
    """The calibration that this package ships."""
    return read(PACKAGED)
