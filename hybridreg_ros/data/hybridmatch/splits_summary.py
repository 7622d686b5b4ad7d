# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What a split holds: counts, seeds and distributions, as written into split.json."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.hybridmatch.room_pairs import GENERATOR_VERSION

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from hybridreg_ros.data.hybridmatch.splits_files import Row

_BINS = 20


@dataclass(frozen=True)
class Distribution:
    """How one quantity is spread over the pairs of a split.

    Attributes:
        minimum: smallest value.
        mean: mean.
        median: median.
        maximum: largest value.
        edges: K + 1 edges of the histogram.
        counts: K pairs between them.
    """

    minimum: float
    mean: float
    median: float
    maximum: float
    edges: tuple[float, ...]
    counts: tuple[int, ...]


@dataclass(frozen=True)
class SplitSummary:
    """What was made.

    Attributes:
        split: split name.
        pairs: number of pairs.
        seed: first scene seed.
        last_seed: last scene seed that was used.
        scenes: number of scenes looked at.
        layout: shards or official.
        generator_version: version of the generator.
        distributions: overlap (share), dynamic_share (share), points (per cloud) and
            displacement_m (mean displacement of the key figure's vertices, metres).
    """

    split: str
    pairs: int
    seed: int
    last_seed: int
    scenes: int
    layout: str
    generator_version: int
    distributions: dict[str, Distribution]


def summarise(
    split: str, seed: int, layout: str, scenes: int, rows: Sequence[Row]
) -> SplitSummary:
    """Summary of the pairs of a split, at least one."""
    points = np.array([[row.source_points, row.target_points] for row in rows]).reshape(-1)
    top = 5000.0 * np.ceil(max(points.max(), 1) / 5000.0)
    moved = np.array([row.displacement_m for row in rows])
    return SplitSummary(
        split,
        len(rows),
        seed,
        seed + scenes - 1,
        scenes,
        layout,
        GENERATOR_VERSION,
        {
            'overlap': _spread(np.array([row.overlap for row in rows]), 1.0),
            'dynamic_share': _spread(np.array([row.dynamic_share for row in rows]), 1.0),
            'points': _spread(points, float(top)),
            'displacement_m': _spread(moved, float(max(2.0, np.ceil(moved.max())))),
        },
    )


def _spread(values: NDArray[np.floating] | NDArray[np.integer], top: float) -> Distribution:
    counts, edges = np.histogram(values, _BINS, (0.0, top))
    return Distribution(
        float(values.min()),
        float(values.mean()),
        float(np.median(values)),
        float(values.max()),
        tuple(round(float(e), 6) for e in edges),
        tuple(int(c) for c in counts),
    )


def read_summary(folder: Path) -> SplitSummary:
    """Read `split.json`.

    Raises:
        FileFormatError: it is missing or malformed.
    """
    path = folder / 'split.json'
    try:
        found = json.loads(path.read_text(encoding='utf-8'))
        spreads = {
            name: Distribution(**{**d, 'edges': tuple(d['edges']), 'counts': tuple(d['counts'])})
            for name, d in found.pop('distributions').items()
        }
        return SplitSummary(distributions=spreads, **found)
    except OSError as error:
        raise FileFormatError(f'cannot read {path}: {error.strerror}') from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileFormatError(
            f'{path} is not a summary of a split ({error}); generate the split again'
        ) from None
