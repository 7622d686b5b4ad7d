# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A run in the viewer Rerun: while it is replayed, or as a .rrd file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.replay.page.pictures import MOVING, is_optical
from hybridreg_ros.replay.runner import DYNAMIC_THRESHOLD

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.metrics.trajectory import Trajectory
    from hybridreg_ros.odometry.result import OdometryResult

LIVE = 'live'
_TIME = 'stamp'
_STILL, _PATH, _TRUTH = (150, 158, 167), (79, 155, 224), (255, 255, 255)


class RerunSink:
    """Sends every scan: pose, points that stand still and points that move, path, confidence."""

    def __init__(self, target: str, name: str, threshold: float = DYNAMIC_THRESHOLD) -> None:
        """Open a viewer or a file.

        Args:
            target: LIVE for a viewer on this machine, its address (rerun+http://...), or a file.
            name: of the recording.
            threshold: dynamic probability from which a point counts as moving.

        Raises:
            ConfigError: there is no viewer, or the file cannot be written.
        """
        import rerun
        from rerun import blueprint

        self._rr, self._threshold = rerun, threshold
        self._out = rerun.RecordingStream('hybridreg')
        try:
            if target == LIVE:
                self._out.spawn()
            elif '://' in target:
                self._out.connect_grpc(target)
            else:
                self._out.save(target)
        except (RuntimeError, ValueError, OSError) as error:
            raise ConfigError(f'--rerun {target}: {" ".join(str(error).split())}') from None
        bounds = blueprint.TimeRangeBoundary
        so_far = blueprint.VisibleTimeRanges(
            timeline=_TIME, start=bounds.infinite(), end=bounds.cursor_relative(seconds=0)
        )
        scene = blueprint.Spatial3DView(origin='odom', overrides={'odom/path': so_far})
        below = blueprint.TimeSeriesView(origin='confidence')
        rows = blueprint.Vertical(scene, below, row_shares=[4, 1])
        self._out.send_blueprint(blueprint.Blueprint(rows, collapse_panels=True))
        self._out.send_recording_name(name)
        self._last: NDArray[np.float64] | None = None

    def add(self, message: Any, result: OdometryResult) -> None:
        """Send the result of one scan."""
        rr, out, points = self._rr, self._out, result.scan.points
        place = result.pose[:3, 3]
        if self._last is None:
            axes = rr.ViewCoordinates.RDF if is_optical(points) else rr.ViewCoordinates.FLU
            out.log('odom', axes, static=True)
            self._last = place
        out.set_time(_TIME, timestamp=np.datetime64(result.stamp, 'ns'))
        out.log('odom/sensor', rr.Transform3D(translation=place, mat3x3=result.pose[:3, :3]))
        moves = result.dynamic_probability >= self._threshold
        for part, rows, colour, size in (
            ('still', ~moves, _STILL, 1.5),
            ('moving', moves, MOVING, 3.0),
        ):
            radii = rr.Radius.ui_points(size)
            out.log(f'odom/sensor/{part}', rr.Points3D(points[rows], colors=colour, radii=radii))
        out.log('odom/path', rr.LineStrips3D([np.stack([self._last, place])], colors=_PATH))
        out.log('confidence', rr.Scalars(result.confidence))
        self._last = place

    def end(
        self,
        made: Trajectory,
        optical: bool,
        truth: Trajectory | None = None,
        T_odom_world: NDArray[np.float64] | None = None,
    ) -> None:
        """Send the true path, aligned."""
        if truth is not None and T_odom_world is not None:
            path = se3.apply(T_odom_world, truth.poses[:, :3, 3])
            self._out.log('odom/truth', self._rr.LineStrips3D([path], colors=_TRUTH), static=True)

    def close(self) -> None:
        """Send what is left."""
        self._out.flush()
        self._out.disconnect()
