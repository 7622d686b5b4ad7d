# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg score`: a trajectory or a bag against the truth."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from hybridreg_ros.cli.common import write_result
from hybridreg_ros.replay.score_files import score_paths

if TYPE_CHECKING:
    import argparse

    from hybridreg_ros.replay.outputs import Scores


def run(args: argparse.Namespace) -> int:
    """Score and print."""
    scores = score_paths(
        args.estimate, args.reference, args.topic, args.ref_topic, args.tolerance, args.extrinsic
    )
    if scores.warning:
        print(f'hybridreg: warning: {scores.warning}', file=sys.stderr)
    print('\n'.join(f'{name:<24}{value:>14}  {unit}' for name, value, unit in lines(scores)))
    write_result(args, scores)
    return 0


def lines(scores: Scores) -> list[tuple[str, str, str]]:
    """Name, value and unit of every figure."""
    t, m = scores.trajectory, scores.mask
    rows: list[tuple[str, str, str]] = []
    if t is not None:
        rows += [
            ('poses matched', f'{t.matched}', f'({t.unmatched} without reference)'),
            ('reference not covered', f'{t.reference_unmatched}', ''),
            ('path', f'{t.path_m:.3f}', 'm'),
            ('ATE rmse', f'{t.ate_rmse_m:.5f}', f'm  ({t.ate_percent:.3f} % of the path)'),
            ('ATE max', f'{t.ate_max_m:.5f}', 'm'),
            ('RPE rmse, 1 frame', f'{t.rpe_rmse_m:.5f}', 'm'),
            ('RPE rmse, 1 frame', f'{t.rpe_rmse_deg:.4f}', 'deg'),
            ('step error mean', f'{t.step_mean_mm:.3f}', 'mm'),
            ('step error median', f'{t.step_median_mm:.3f}', 'mm'),
            ('step error max', f'{t.step_max_mm:.3f}', 'mm'),
            ('step error mean', f'{t.step_mean_deg:.4f}', 'deg'),
        ]
        if t.drift is not None:
            spans = f'{t.drift.lengths_m[0]:.3g} to {t.drift.lengths_m[-1]:.3g} m'
            rows += [
                ('KITTI drift', f'{t.drift.translation_percent:.3f}', f'%  (segments {spans})'),
                ('KITTI drift', f'{t.drift.rotation_deg_per_100m:.3f}', 'deg / 100 m'),
            ]
    if m is not None:
        rows += [
            ('dynamic mask IoU', f'{m.iou:.4f}', ''),
            ('dynamic mask precision', f'{m.precision:.4f}', ''),
            ('dynamic mask recall', f'{m.recall:.4f}', ''),
            ('static called moving', f'{100.0 * m.false_share:.3f}', '%'),
        ]
    return rows
