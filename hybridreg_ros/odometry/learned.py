# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The network branch: any Registrar between a scan and a keyframe, encodings kept."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from hybridreg_ros.core.errors import ConfigError, RegistrationError, WeightsError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.keyframes import Keyframe
    from hybridreg_ros.odometry.registrar import Match, Registrar

_log = logging.getLogger(__name__)


def load(model: Any) -> Registrar | None:
    """The registrar behind what a caller passed as `model`.

    Args:
        model: 'auto' for the packaged weights, None for no network, or a Registrar (HybridReg is
            one).

    Returns:
        The registrar, or None when there are no weights (said once in the log).

    Raises:
        ConfigError: `model` is none of these.
    """
    if model is None:
        return None
    if isinstance(model, str) and model == 'auto':
        return _packaged()
    if not (callable(getattr(model, 'encode', None)) and callable(getattr(model, 'match', None))):
        raise ConfigError(
            f"model: expected 'auto', None or a registrar with encode and match, found {model!r}"
        )
    return cast('Registrar', model)


def _packaged() -> Registrar | None:
    from hybridreg_ros.model.register import HybridReg

    try:
        return cast('Registrar', HybridReg.from_pretrained())
    except WeightsError as error:
        _log.warning('no network: %s; kiss-icp makes every pose', error)
        return None


@dataclass(frozen=True, eq=False)
class Proposal:
    """What the network says about a scan.

    Attributes:
        T_odom_sensor: (4, 4) through the keyframe.
        confidence: of the registrar, [0, 1].
        uncertainty: (N,) float32 per point given to `propose`.
        keyframe: the keyframe matched against.
    """

    T_odom_sensor: NDArray[np.float64]
    confidence: float
    uncertainty: NDArray[np.float32]
    keyframe: Keyframe


class LearnedBranch:
    """Encodes each scan once and matches it against keyframes.

    Args:
        registrar: the network.
    """

    def __init__(self, registrar: Registrar) -> None:
        self._registrar = registrar

    def encode(self, points: NDArray[np.float32]) -> Any:
        """Encoding of a scan (N, 3), or None when it cannot be encoded (too few points)."""
        try:
            return self._registrar.encode(points)
        except RegistrationError as error:
            _log.debug('scan not encoded: %s', error)
            return None

    def propose(self, encoding: Any, keyframe: Keyframe | None) -> Proposal | None:
        """Pose of an encoded scan through a keyframe, or None when there is no answer."""
        if encoding is None or keyframe is None or keyframe.encoding is None:
            return None
        try:
            match: Match = self._registrar.match(encoding, keyframe.encoding)
        except RegistrationError as error:
            _log.debug('no match with keyframe %d: %s', keyframe.number, error)
            return None
        return Proposal(
            keyframe.T_odom_keyframe @ match.T_keyframe_scan,
            match.confidence,
            match.uncertainty,
            keyframe,
        )
