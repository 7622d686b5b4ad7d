# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg register`: two cloud files, their transform, its confidence and the time it took."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.cli.common import write_result
from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import ConfigError, require
from hybridreg_ros.data.loaders.clouds import SUFFIXES, read_cloud, write_cloud
from hybridreg_ros.model.register import HybridReg

if TYPE_CHECKING:
    import argparse


def run(args: argparse.Namespace) -> int:
    """Register and print."""
    if args.out is not None and args.out.suffix.lower() not in SUFFIXES:
        raise ConfigError(f'--out {args.out}: expected a file ending in {", ".join(SUFFIXES)}')
    if args.html is not None:
        require('--html', 'replay', 'plotly')
    source, target = (read_cloud(f, args.columns) for f in (args.source, args.target))
    result = HybridReg.from_pretrained(args.weights).register(source, target, args.voxel)
    T = result.T_lgr if args.no_refine else result.T_target_source
    print('T_target_source (metres):')
    print('\n'.join('  ' + ' '.join(f'{value:14.9f}' for value in row) for row in T))
    print(f'confidence       {result.confidence:.4f}')
    print(f'inliers          {result.inliers} of {len(result.correspondences)} correspondences')
    print(f'voxel size       {result.voxel_size_m:g} m')
    for name, values in (('source', source), ('target', target)):
        sigma2 = result.source_uncertainty if name == 'source' else result.target_uncertainty
        print(f'{name} points    {len(values)}, mean uncertainty {float(np.mean(sigma2)):.3f}')
    stages = ', '.join(f'{k} {1000 * v:.0f}' for k, v in result.timings_s.items())
    print(f'milliseconds     {stages}')
    if result.attempts > 1:
        print(f'attempts         {result.attempts}, because the first one left doubt')
    if args.out is not None:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        write_cloud(args.out, se3.apply(T, source.astype(np.float64)))
        print(f'written          {args.out}, the source in the frame of the target')
    if args.html is not None:
        from hybridreg_ros.replay.page.pair import write_pair

        told = [
            f'Confidence {result.confidence:.3f}; {result.inliers} of '
            f'{len(result.correspondences)} correspondences agree.',
            f'The source was moved by {np.linalg.norm(T[:3, 3]):.3f} m and turned by '
            f'{se3.rotation_angle_deg(T[:3, :3]):.2f} degrees.',
        ]
        title = f'{args.source.name} on {args.target.name}'
        write_pair(args.html, title, (source, target), T, result, told)
        print(f'written          {args.html}')
    write_result(
        args,
        {
            'T_target_source': T,
            'refined': not args.no_refine,
            'confidence': result.confidence,
            'inliers': result.inliers,
            'correspondences': len(result.correspondences),
            'voxel_size_m': result.voxel_size_m,
            'timings_s': dict(result.timings_s),
            'attempts': result.attempts,
        },
    )
    return 0
