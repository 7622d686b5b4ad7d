# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The network branch: any Registrar between a scan and a keyframe, encodings kept."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, cast

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import ConfigError, RegistrationError, WeightsError
from hybridreg_ros.model.budget import Budget  # noqa: TC001 (a field of a NamedTuple)
from hybridreg_ros.model.compact_memory import compacted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.model.static_points import PointMask
    from hybridreg_ros.odometry.keyframes import Keyframe


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


class Encoded(NamedTuple):
    """A cloud encoded at a budget; only those of one budget can be matched."""

    budget: Budget
    encoding: Any


class LearnedBranch:
    """Matches scans with keyframes; each cloud is encoded once, and only when it is needed.

    Args:
        registrar: the network; of one with a method `sequence`, one is begun for each budget, to
            keep one voxel.
        memory: encodings of keyframes kept at most, those that were asked for last. Those of our
            recordings take 2 to 5 MB at the full budget.
    """

    def __init__(self, registrar: Registrar, memory: int) -> None:
        self._registrar = registrar
        self._sequences: dict[Budget, Registrar] = {}
        self._memory = memory
        self._keyframes: dict[tuple[int, Budget], Any] = {}

    def _of(self, budget: Budget) -> Registrar:
        """The registrar whose voxel keeps to a budget."""
        if budget not in self._sequences:
            begin = getattr(self._registrar, 'sequence', None)
            self._sequences[budget] = self._registrar if begin is None else begin(budget)
        return self._sequences[budget]

    def encode(self, points: NDArray[np.float32], budget: Budget) -> Encoded | None:
        """Encode a scan (M, 3), sensor frame, metres; None when it cannot be encoded."""
        try:
            return Encoded(budget, self._of(budget).encode(points))
        except RegistrationError as error:
            _log.debug('scan not encoded: %s', error)
            return None

    def encode_finer(
        self, points: NDArray[np.float32], scan: Encoded | None, budget: Budget
    ) -> Encoded | None:
        """Encode a scan at a larger budget; None when that would not make its voxel smaller.

        Args:
            points: (M, 3) of the scan, sensor frame, metres.
            scan: it at the budget so far, None = it cannot be encoded.
            budget: the larger one.
        """
        if scan is None:
            return None
        coarse, fine = (getattr(self._of(b), 'voxel_size_m', 0.0) for b in (scan.budget, budget))
        if fine is not None and fine >= coarse:
            return None
        found = self.encode(points, budget)  # the first of a budget chooses its voxel
        return found if getattr(self._of(budget), 'voxel_size_m', 0.0) < coarse else None

    def adopt(self, keyframe: Keyframe, encoded: Encoded | None) -> None:
        """A scan has become this keyframe: keep its encoding unless it is None."""
        if encoded is not None:
            self._keep(keyframe, encoded.budget, compacted(encoded.encoding))

    def forget(self, keyframe: Keyframe) -> None:
        """A keyframe has changed: encode it anew when it is matched next."""
        self._keyframes = {k: e for k, e in self._keyframes.items() if k[0] != keyframe.number}

    def keep_only(self, keyframes: Iterable[Keyframe]) -> None:
        """Let go of the encodings of all other keyframes: they are not asked for any more."""
        numbers = {keyframe.number for keyframe in keyframes}
        self._keyframes = {k: e for k, e in self._keyframes.items() if k[0] in numbers}

    def _keep(self, keyframe: Keyframe, budget: Budget, encoding: Any) -> None:
        """Keep an encoding as the one that was asked for last."""
        self._keyframes[keyframe.number, budget] = encoding
        if len(self._keyframes) > self._memory:
            del self._keyframes[next(iter(self._keyframes))]

    def propose(self, scan: Encoded | None, keyframe: Keyframe | None) -> Proposal | None:
        """Pose of a scan through a keyframe, or None when there is no answer.

        Args:
            scan: by `encode`.
            keyframe: what it is matched with; encoded if it is not yet at this budget.
        """
        if keyframe is None or scan is None:
            return None
        registrar = self._of(scan.budget)
        try:
            known = self._keyframes.pop((keyframe.number, scan.budget), None)
            if known is None:
                known = compacted(registrar.encode(keyframe.points))
            self._keep(keyframe, scan.budget, known)
            match: Match = registrar.match(scan.encoding, known)
        except RegistrationError as error:
            _log.debug('no match with keyframe %d: %s', keyframe.number, error)
            return None
        return Proposal(
            keyframe.T_odom_keyframe @ match.T_keyframe_scan,
            match.confidence,
            match.uncertainty,
            keyframe,
        )

    def point_mask(
        self, scan: Encoded, keyframe: Keyframe, T_odom_sensor: NDArray[np.float64]
    ) -> Callable[[], PointMask | None] | None:
        """Which points of a scan are static, by what a keyframe saw; nothing is encoded for it.

        What is needed is taken now, so that the answer may be made in another thread while the
        next scan is matched.

        Args:
            scan: by `encode`.
            keyframe: need not be the one that the scan was matched with.
            T_odom_sensor: (4, 4) pose of the scan.

        Returns:
            Gives P(static) and P(seen by the keyframe) per point given to `encode`, or None for
            weights without a static head; None where the keyframe is not kept at this budget, or
            the registrar has no such answer.
        """
        known = self._keyframes.get((keyframe.number, scan.budget))
        ask = getattr(self._of(scan.budget), 'point_mask', None)
        if ask is None or known is None:
            return None
        T_keyframe_scan = se3.inverse(keyframe.T_odom_keyframe) @ T_odom_sensor
        return partial(_answer, partial(ask, scan.encoding, known, T_keyframe_scan))


def _answer(ask: Callable[[], PointMask]) -> PointMask | None:
    """What a registrar says, None where its weights have no static head."""
    try:
        return ask()
    except WeightsError:
        return None


@dataclass(frozen=True, eq=False)
class Match:
    """A scan aligned with a keyframe.

    Attributes:
        T_keyframe_scan: (4, 4) float64, metres.
        confidence: calibrated P(transform right), [0, 1].
        uncertainty: (N,) float32, sigma^2 in [0, 1] per point of the scan; 1 = do not trust
            (moving, deforming or not seen by the keyframe).
        inliers: number of correspondences that agree with the transform.
    """

    T_keyframe_scan: NDArray[np.float64]
    confidence: float
    uncertainty: NDArray[np.float32]
    inliers: int


class Registrar(Protocol):
    """Global registration of a scan against a keyframe; a scan is encoded once."""

    def encode(self, points: NDArray[np.float32]) -> Any:
        """Encoding of one cloud (N, 3), sensor frame, metres, kept with a keyframe.

        Raises:
            RegistrationError: too few points, or no extent.
        """

    def match(self, scan: Any, keyframe: Any) -> Match:
        """Align the encoding of a scan with that of a keyframe.

        Raises:
            RegistrationError: the encodings cannot be matched.
        """
