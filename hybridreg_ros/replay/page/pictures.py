# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Frames seen from the sensor with their dynamic mask, as small PNG pictures."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import require
from hybridreg_ros.replay.runner import DYNAMIC_THRESHOLD, true_dynamic

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.result import OdometryResult

BACKGROUND = (18, 22, 28)
MOVING = (232, 119, 34)
FALSE_ALARM = (214, 122, 190)
MISSED = (64, 156, 255)
WIDTH, MIN_HEIGHT, MAX_HEIGHT = 960, 200, 640
WIDE_DEG, STRETCH = 120.0, 2.0
FILM_WIDTH, FILM_FRAMES = 480, 300


@dataclass(frozen=True, eq=False)
class FrameView:
    """One frame kept for the report.

    Attributes:
        stamp: ns.
        points: (N, 3) float32, sensor frame, metres.
        moving: (N,) True where the front end says so.
        truth: (N,) True where the point moves, None without labels.
    """

    stamp: int
    points: NDArray[np.float32]
    moving: NDArray[np.bool_]
    truth: NDArray[np.bool_] | None


class Album:
    """Keeps a few frames of a run: evenly spaced ones and the one with most moving points."""

    def __init__(self, frames: int, wanted: int = 3, threshold: float = DYNAMIC_THRESHOLD) -> None:
        """Plan an album.

        Args:
            frames: expected number of frames.
            wanted: evenly spaced frames to keep.
            threshold: dynamic probability from which a point counts as moving.
        """
        self._every = max(1, frames // (wanted + 1))
        self._wanted = wanted
        self._threshold = threshold
        self._seen = 0
        self._kept: list[FrameView] = []
        self._best: tuple[int, FrameView] | None = None

    def add(self, message: Any, result: OdometryResult) -> None:
        """Look at one result and the message it came from."""
        self.offer(
            FrameView(
                result.stamp,
                result.scan.points,
                result.dynamic_probability >= self._threshold,
                true_dynamic(message, result.scan),
            )
        )

    def offer(self, view: FrameView) -> None:
        """Look at one frame."""
        self._seen += 1
        due = self._seen % self._every == 0 and len(self._kept) < self._wanted
        interest = int((view.moving if view.truth is None else view.moving | view.truth).sum())
        if due:
            self._kept.append(view)
        if interest and (self._best is None or interest > self._best[0]):
            self._best = (interest, view)

    def views(self) -> list[FrameView]:
        """The frames kept, in the order of time."""
        chosen = {v.stamp: v for v in self._kept}
        if self._best is not None:
            chosen[self._best[1].stamp] = self._best[1]
        return [chosen[stamp] for stamp in sorted(chosen)]


def is_optical(points: NDArray[np.floating]) -> bool:
    """Whether points (N, 3) are those of a camera: x right, y down, z ahead (REP-103)."""
    if not len(points):
        return False
    return bool((points[:, 2] > 0.0).mean() > 0.99 and (points[:, 0] > 0.0).mean() < 0.99)


def _directions(
    points: NDArray[np.float32],
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Place of each point to the right and up, as the sensor sees it, and whether it looks around.

    A camera's points are projected on a plane; those of a sensor that looks around keep their
    angles in degrees.
    """
    x, y, z = points.astype(np.float64).T
    # Other frames than optical ones have x forward, y left, z up (REP-103).
    right, up, forward = (x, -y, z) if is_optical(points) else (-y, z, x)
    azimuth = np.rad2deg(np.arctan2(right, forward))
    low, high = np.percentile(azimuth, [0.2, 99.8])
    if max(-low, high) < 0.5 * WIDE_DEG:
        depth = np.maximum(forward, 1e-6)
        return right / depth, up / depth, False
    return azimuth, np.rad2deg(np.arctan2(up, np.hypot(right, forward))), True


def _colours(view: FrameView, distance: NDArray[np.float64]) -> NDArray[np.uint8]:
    """(N, 3) colour of each point: grey by distance, moving ones by class."""
    far = max(float(np.percentile(distance, 98)), 1e-6)
    grey = (225.0 - 150.0 * np.clip(distance / far, 0.0, 1.0)).astype(np.uint8)
    colours = np.repeat(grey[:, None], 3, axis=1)
    if view.truth is None:
        colours[view.moving] = MOVING
        return colours
    colours[view.moving & view.truth] = MOVING
    colours[view.moving & ~view.truth] = FALSE_ALARM
    colours[~view.moving & view.truth] = MISSED
    return colours


def render(view: FrameView) -> bytes:
    """PNG of a frame in angles around the sensor; near points cover far ones."""
    stream = io.BytesIO()
    drawn(view).save(stream, 'PNG')
    return stream.getvalue()


def drawn(view: FrameView) -> Any:
    """The same as an image of pillow.

    Raises:
        DependencyError: pillow is not installed.
    """
    require('a picture', 'replay', 'PIL')
    from PIL import Image

    empty = np.full((MIN_HEIGHT, WIDTH, 3), BACKGROUND, dtype=np.uint8)
    return Image.fromarray(_raster(view) if len(view.points) else empty)


class Film:
    """A sink that draws every frame, as the sensor saw it, with its moving points.

    Args:
        threshold: dynamic probability from which a point counts as moving.
    """

    def __init__(self, threshold: float = DYNAMIC_THRESHOLD) -> None:
        self._threshold = threshold
        self._frames: dict[int, Any] = {}
        self._seen, self._every = 0, 1

    def add(self, message: Any, result: OdometryResult) -> None:
        """Draw one frame; of a long run every second, fourth, ... is kept."""
        if self._seen % self._every == 0:
            moving = result.dynamic_probability >= self._threshold
            image = drawn(FrameView(result.stamp, result.scan.points, moving, None))
            height = 2 * round(image.height * FILM_WIDTH / image.width / 2)  # as H.264 needs
            if self._frames:  # all frames of a film have one size
                height = next(iter(self._frames.values())).height
            small = image.resize((FILM_WIDTH, height))
            self._frames[result.stamp] = small.quantize(palette=_palette(), dither=0)
        self._seen += 1
        if len(self._frames) > FILM_FRAMES:
            self._frames = dict(list(self._frames.items())[::2])
            self._every *= 2

    def write(self, path: Path) -> None:
        """Write a .gif, .webp or .mp4; it lasts as long as the run (at 10 to 50 Hz)."""
        images = list(self._frames.values())
        if not images:
            return
        stamps = list(self._frames)
        gap_ms = 1e-6 * (stamps[-1] - stamps[0]) / max(len(stamps) - 1, 1)
        gap_ms = float(np.clip(gap_ms, 20, 100))
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix.lower() == '.mp4':
            from imageio_ffmpeg import write_frames

            film = write_frames(str(path), images[0].size, fps=1000.0 / gap_ms, macro_block_size=2)
            film.send(None)
            for image in images:
                film.send(image.convert('RGB').tobytes())
            film.close()
            return
        images[0].save(
            path,
            save_all=True,
            append_images=images[1:],
            duration=int(gap_ms),
            loop=0,
            quality=40,
        )


def _palette() -> Any:
    """Greys, and the colour of what moves on its way to the background."""
    from PIL import Image

    share = np.linspace(0.1, 1.0, 16)[:, None]
    oranges = share * np.array(MOVING) + (1.0 - share) * np.array(BACKGROUND)
    greys = np.linspace(BACKGROUND, (230, 230, 230), 48)
    image = Image.new('P', (1, 1))
    image.putpalette(np.concatenate([greys, oranges]).round().astype(int).ravel().tolist())
    return image


def _raster(view: FrameView) -> NDArray[np.uint8]:
    across, upward, around = _directions(view.points)
    distance = np.linalg.norm(view.points.astype(np.float64), axis=1)
    a0, a1 = np.percentile(across, [0.2, 99.8])
    e0, e1 = np.percentile(upward, [0.2, 99.8])
    wide, tall = max(a1 - a0, 1e-3), max(e1 - e0, 1e-3)
    stretch = STRETCH if around else 1.0
    height = int(np.clip(tall / wide * WIDTH * stretch, MIN_HEIGHT, MAX_HEIGHT))
    image = np.full((height, WIDTH, 3), BACKGROUND, dtype=np.uint8)
    order = np.argsort(-distance)
    colours = _colours(view, distance)[order]
    column = ((across - a0) / wide * (WIDTH - 1)).astype(np.int64)[order]
    row = ((e1 - upward) / tall * (height - 1)).astype(np.int64)[order]
    largest = 4 if around else 12
    splat = int(np.clip(np.ceil(1.05 * np.sqrt(WIDTH * height / len(order))), 1, largest))
    step = np.arange(splat)
    rows = (row[:, None, None] + step[:, None]).repeat(splat, axis=2).reshape(len(row), -1)
    columns = (column[:, None, None] + step).repeat(splat, axis=1).reshape(len(row), -1)
    inside = ((rows >= 0) & (rows < height) & (columns >= 0) & (columns < WIDTH)).ravel()
    painted = np.repeat(colours, splat * splat, axis=0)
    image[rows.ravel()[inside], columns.ravel()[inside]] = painted[inside]
    return image
