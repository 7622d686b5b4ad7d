# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pictures of a split: a contact sheet of pairs, and histograms with the limits of the split."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import FileFormatError, require
from hybridreg_ros.core.se3 import apply
from hybridreg_ros.data.hybridmatch.preview_raster import (
    BLUE,
    LABEL_COLOURS,
    ORANGE,
    Projection,
    depth_colours,
    occupied,
    paint,
)
from hybridreg_ros.data.hybridmatch.room_pairs import LEVELS, LOMATCH, MATCH, RECORDED, TRAIN
from hybridreg_ros.data.hybridmatch.shards import open_split
from hybridreg_ros.data.hybridmatch.stage import MIN_DISPLACEMENT_M

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from hybridreg_ros.data.hybridmatch.splits_summary import SplitSummary
    from hybridreg_ros.data.pair import PointPair

_TITLES = ('depth', 'labels', 'aligned', 'overlap')
_GREEN, _GREY = np.array([60, 160, 70]), np.array([150, 150, 150])
_NEAR_VOXELS = 1.5


def write_preview(folder: Path, summary: SplitSummary, rows: int = 6) -> list[Path]:
    """Write `preview.png` and `distributions.png` into the folder of a split of shards.

    Args:
        folder: of the split.
        summary: of the split.
        rows: number of pairs shown, spread evenly over the split.

    Returns:
        The files written.

    Raises:
        FileFormatError: the folder holds no shards with pairs.
        DependencyError: matplotlib is not installed.
    """
    split = open_split(folder)
    if len(split) == 0:
        raise FileFormatError(f'{folder} holds no shards: a preview needs `--layout shards`')
    chosen = np.unique(np.linspace(0, len(split) - 1, min(rows, len(split))).round().astype(int))
    sheet, charts = folder / 'preview.png', folder / 'distributions.png'
    draw_sheet([split[int(k)] for k in chosen], sheet)
    draw_distributions(summary, charts)
    return [sheet, charts]


def figure(width: float, height: float) -> Any:
    """An empty matplotlib figure, inches.

    Raises:
        DependencyError: matplotlib is not installed.
    """
    require('a picture', 'data', 'matplotlib')
    from matplotlib.figure import Figure

    return Figure((width, height), layout='constrained')


def save(sheet: Any, path: Path) -> None:
    """Save with 128 colours: a third of the size, and the eye sees no difference."""
    from PIL import Image

    buffer = io.BytesIO()
    sheet.savefig(buffer, format='png', dpi=85)
    image = Image.open(buffer).convert('RGB')
    image.quantize(128, dither=Image.Dither.NONE).save(path, optimize=True)


def draw_sheet(pairs: Sequence[PointPair], path: Path) -> None:
    """Draw one row per pair: depth, labels, both clouds aligned, and what both of them see.

    Raises:
        DependencyError: matplotlib is not installed.
    """
    sheet = figure(10.4, 2.15 * len(pairs) + 0.2)
    axes = sheet.subplots(len(pairs), len(_TITLES), squeeze=False)
    for row, pair in zip(axes, pairs, strict=True):
        for axis, panel in zip(row, panels(pair), strict=True):
            axis.imshow(panel)
            axis.set(xticks=[], yticks=[])
        row[0].set_ylabel(
            f'overlap {pair.overlap:.2f}\nmoving {pair.dynamic_share:.2f}', fontsize=8
        )
        row[1].set_title(
            f'{pair.name}, {len(pair.source)} and {len(pair.target)} points', fontsize=7, pad=2
        )
    for axis, title in zip(axes[-1], _TITLES, strict=True):
        axis.set_xlabel(title, fontsize=8)
    save(sheet, path)


def panels(pair: PointPair) -> list[NDArray[np.uint8]]:
    """The four images (H, W, 3) of a pair: depth, labels, aligned, overlap."""
    view = Projection.of(pair.source)
    in_target = apply(pair.T_target_source, pair.source)
    both = np.concatenate([in_target, pair.target])
    side = np.repeat([0, 1], [len(in_target), len(pair.target)])
    seen = occupied(in_target, pair.target, _NEAR_VOXELS * pair.voxel_size_m)
    common = np.where(seen[:, None], _GREEN, _GREY)
    common = np.where(pair.source_label[:, None] > 0, LABEL_COLOURS[pair.source_label], common)
    outside = Projection.above(pair.target)
    return [
        paint(view, pair.source, depth_colours(view.depth(pair.source))),
        paint(view, pair.source, LABEL_COLOURS[pair.source_label]),
        paint(outside, both, np.stack([BLUE, ORANGE])[side]),
        paint(outside, in_target, common),
    ]


def draw_distributions(summary: SplitSummary, path: Path) -> None:
    """Draw a histogram of each quantity, with the limits of the split as dashed lines.

    Raises:
        DependencyError: matplotlib is not installed.
    """
    names = list(summary.distributions)
    sheet = figure(2.9 * len(names), 2.3)
    limits = limits_of(summary.split)
    for axis, name in zip(sheet.subplots(1, len(names), squeeze=False)[0], names, strict=True):
        spread = summary.distributions[name]
        edges = np.array(spread.edges)
        axis.bar(edges[:-1], spread.counts, np.diff(edges), align='edge', color='#4477aa')
        for limit in limits.get(name, ()):
            axis.axvline(limit, color='#cc3311', linestyle='--', linewidth=1.0)
        axis.set_xlabel(name.replace('_', ' '), fontsize=8)
        axis.tick_params(labelsize=7)
    sheet.suptitle(f'{summary.split}: {summary.pairs} pairs, {summary.scenes} scenes', fontsize=9)
    save(sheet, path)


def limits_of(split: str) -> dict[str, tuple[float, ...]]:
    """Limits that the paper sets on the quantities of a split."""
    _, kind, *level = split.split('-', 2)
    if kind == RECORDED:
        return {}
    if kind == TRAIN:
        return {'displacement_m': (MIN_DISPLACEMENT_M,)}
    limits: dict[str, tuple[float, ...]] = {'overlap': MATCH[:1] if kind == 'match' else LOMATCH}
    if level[0] != 'rigid':
        limits['dynamic_share'] = LEVELS[level[0]]
        limits['displacement_m'] = (MIN_DISPLACEMENT_M,)
    return limits
