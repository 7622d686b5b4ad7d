# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What one step of the front end returns; the node, the replay and users read only this."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from enum import StrEnum
from time import perf_counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.core.scan import Scan

LOST_VARIANCE = 9999.0
"""Diagonal of the covariance (m^2, rad^2) of a pose that must not be used (as rtabmap_ros)."""


class Source(StrEnum):
    """Which branch made the pose of a step; both kinds are refined point to plane in the map."""

    HYBRIDREG = 'hybridreg'
    KISS_ICP = 'kiss_icp'
    LOST = 'lost'


class Reason(StrEnum):
    """Why a step took its branch; one word for diagnostics, logs and tests."""

    OK = 'ok'
    FIRST_SCAN = 'first_scan'
    NO_WEIGHTS = 'no_weights'
    REGISTRAR_KISS_ICP = 'registrar_kiss_icp'
    LOW_CONFIDENCE = 'low_confidence'
    TOO_FEW_POINTS = 'too_few_points'
    DISAGREES_WITH_MOTION = 'disagrees_with_motion'
    REFINEMENT_FAILED = 'refinement_failed'
    NO_OVERLAP = 'no_overlap'
    DEGENERATE = 'degenerate'
    RECOVERED = 'recovered'
    STAMP_REPEATED = 'stamp_repeated'
    STAMP_BACKWARDS = 'stamp_backwards'
    STAMP_JUMP = 'stamp_jump'
    FRAME_CHANGED = 'frame_changed'


@dataclass(frozen=True, eq=False)
class OdometryResult:
    """Outcome of one scan.

    Attributes:
        scan: the scan this result belongs to, as given to `step`.
        pose: (4, 4) float64 T_odom_sensor at the scan's stamp, metres.
        covariance: (6, 6) of the pose, order x y z rot_x rot_y rot_z, m^2 and rad^2, fixed axes of
            the odom frame (REP-103); 9999 on the diagonal when `source` is LOST.
        twist: (6,) linear (m/s) and angular (rad/s) velocity in the sensor frame.
        twist_covariance: (6, 6) of `twist`.
        source: the branch that made the pose; of a pose that is only predicted (confidence 0), the
            branch of the pose that the prediction starts from.
        reason: why that branch.
        confidence: calibrated P(pose right), [0, 1]; 0 when LOST.
        dynamic_probability: (N,) float32 in [0, 1], one value per point of `scan.points`.
        mask_known: whether earlier scans reach back far enough (0.25 s) to tell what stands still.
        keyframe_id: number of the keyframe the scan was matched against.
        is_keyframe: True when this scan became a keyframe.
        accepted: False when the scan was refused (bad stamp, frame change): pose repeats.
        timings_s: seconds per stage (preprocess, encode, match, refine, dynamics, map, total).
        deskewed: True when the points were deskewed by constant velocity.
        load: 0 = all of a step was done; more = less of it, since scans come too fast.
        weak_direction: (3,) unit direction, odom axes, along which no surface holds the position;
            None = there is none.
        adrift: True from when a new map began, since the old one was not found again or is too
            small for the scene: how far off it begins stays in the covariance.
    """

    scan: Scan
    pose: NDArray[np.float64]
    covariance: NDArray[np.float64]
    twist: NDArray[np.float64]
    twist_covariance: NDArray[np.float64]
    source: Source
    reason: Reason
    confidence: float
    dynamic_probability: NDArray[np.float32]
    mask_known: bool = True
    keyframe_id: int = 0
    is_keyframe: bool = False
    accepted: bool = True
    timings_s: Mapping[str, float] = field(default_factory=dict)
    deskewed: bool = False
    load: int = 0
    weak_direction: NDArray[np.float64] | None = None
    adrift: bool = False

    @property
    def stamp(self) -> int:
        """Stamp of the scan, ns."""
        return self.scan.stamp


class Rest:
    """The part of a step that can wait: done once, by whoever calls it first, in any thread."""

    def __init__(self, make: Callable[[], OdometryResult]) -> None:
        self._make: Callable[[], OdometryResult] | None = make
        self._lock = threading.Lock()
        self._result: OdometryResult | None = None

    def __call__(self) -> OdometryResult:
        """The whole result.

        Raises:
            RuntimeError: it was begun before, and what went wrong was raised there.
        """
        self.wait()
        if self._result is None:
            raise RuntimeError('the rest of this step failed')
        return self._result

    def wait(self) -> None:
        """Return once it is done; it is done here if nobody began it."""
        with self._lock:
            make, self._make = self._make, None
            if make is not None:
                self._result = make()


class Watch:
    """Books the time of one step under its stages."""

    def __init__(self) -> None:
        self._start = self._last = perf_counter()
        self._laps: dict[str, float] = {}

    def resume(self) -> None:
        """Leave out the time since the last lap: nothing was done for this step."""
        now = perf_counter()
        self._start += now - self._last
        self._last = now

    def lap(self, stage: str) -> None:
        """Book the time since the last lap under a stage."""
        now = perf_counter()
        self._laps[stage] = self._laps.get(stage, 0.0) + now - self._last
        self._last = now

    def laps(self) -> Mapping[str, float]:
        """Seconds per stage, and `total`."""
        return {**self._laps, 'total': perf_counter() - self._start}
