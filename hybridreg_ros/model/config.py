# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""ModelConfig: every size of the network, and the two profiles `compact` and `paper`."""

from __future__ import annotations

from dataclasses import dataclass

from hybridreg_ros.core.config import option, validate
from hybridreg_ros.core.errors import ConfigError


@dataclass(frozen=True)
class ModelConfig:
    """Sizes and choices of HybridReg; lengths are in voxels of the finest level.

    Level l has voxels of 2^l finest voxels. The defaults are the profile `compact` but for the
    voxel factor, which weights from before there was one do not name.
    """

    # pyramid
    voxel_factor: float = option(
        1.0,
        'finest voxel relative to the one that suits the sensor (0.05 m in rooms, 0.3 m in '
        'streets)',
        low=0.25,
        high=4.0,
    )
    max_points: int = option(
        30_000,
        'maximum number of points on the finest level; larger clouds are thinned evenly',
        low=100,
    )
    max_superpoints: int = option(
        768, 'maximum number of points on the coarsest level; more are thinned', low=8
    )
    radius: float = option(2.5, 'neighbour radius, voxels of its level', low=1.0, high=5.0)
    neighbours: int = option(
        20, 'maximum number of neighbours within that radius, nearest first', low=4, high=64
    )
    # backbone
    stem: int = option(32, 'width of the first convolution', low=8)
    widths: tuple[int, ...] = option((64, 128, 256, 512), 'width of each level', low=8)
    bottleneck: int = option(4, 'a block convolves at width / bottleneck', low=1, high=8)
    extra_blocks: int = option(
        1, 'number of residual blocks per level after the first one', low=0, high=4
    )
    groups: int = option(
        8, 'number of groups of every group normalisation (per cloud)', low=1, high=64
    )
    kernel_points: int = option(
        15, 'number of kernel points, one of them in the centre', low=5, high=32
    )
    kernel_radius: float = option(
        1.5, 'distance of the kernel points from the centre, voxels', low=0.5, high=4.0
    )
    kernel_extent: float = option(1.2, 'reach of their linear influence, voxels', low=0.5)
    fine_level: int = option(1, 'level of the fine points', low=0, high=2)
    fine_dim: int = option(64, 'width of the fine features', low=8)
    # geometric transformer
    dim: int = option(128, 'width of the transformer', low=16)
    heads: int = option(4, 'number of attention heads', low=1, high=16)
    blocks: int = option(
        3, 'number of pairs of self-attention and cross-attention', low=1, high=12
    )
    sigma_distance: float = option(4.0, 'unit of distances in the embedding, voxels', low=0.1)
    sigma_angle_deg: float = option(15.0, 'unit of angles in the embedding', low=1.0, high=90.0)
    angle_neighbours: int = option(3, 'number of neighbours that span the angles', low=1, high=8)
    angle_reduction: str = option(
        'mean', 'how the angles of those neighbours are combined', choices=('mean', 'max')
    )
    distance_bins: int = option(512, 'number of rows of the distance table', low=16, high=4096)
    distance_step: float = option(0.625, 'voxels per row of the distance table', low=0.05)
    angle_bins: int = option(
        129, 'number of rows of the angle table over 180 degrees', low=16, high=1024
    )
    # uncertainty mask
    mask_outputs: int = option(
        2,
        'logits of the mask: 2 = static and seen separately, 1 = one for both (paper)',
        low=1,
        high=2,
    )
    use_mask: bool = option(True, 'let the mask weigh the superpoint correlation')
    mask_combination: str = option(
        'confidence_product',
        'weight of a superpoint pair',
        choices=('confidence_product', 'variance_product'),
    )
    mask_exponent: float = option(0.5, 'exponent of that weight', low=0.0, high=4.0)
    static_width: int = option(
        0, 'width of the head that gives P(static) per point under a pose; 0 = none', low=0
    )
    # superpoint and point matching
    top_pairs: int = option(64, 'number of superpoint pairs kept', low=1, high=1024)
    pair_temperature: float = option(
        0.05,
        'temperature of the correlation that ranks them; 0.5 in the paper',
        low=0.005,
        high=1.0,
    )
    dual_normalisation: bool = option(True, 'normalise the correlation over rows and columns')
    patch_size: int = option(32, 'maximum number of fine points in a patch', low=4, high=256)
    patch_radius: float = option(
        12.0, 'maximum distance of a patch from its superpoint, voxels', low=1.0
    )
    sinkhorn_iterations: int = option(20, 'number of Sinkhorn iterations', low=1, high=200)
    # pose
    mutual_top: int = option(
        3, 'number of largest entries per row and column that may match', low=1, high=16
    )
    min_score: float = option(0.05, 'minimum score of a point match', low=0.0, high=1.0)
    acceptance_radius: float = option(2.0, 'inlier distance of LGR, voxels', low=0.1)
    refinements: int = option(5, 'number of refits to the inliers', low=1, high=50)
    estimator: str = option(
        'verified',
        'how the pose is found: best of many hypotheses by the fit of the clouds, or from the '
        'point matches alone',
        choices=('verified', 'lgr', 'ransac'),
    )
    ransac_samples: int = option(
        0, 'number of best point matches that RANSAC draws from; 0 = all', low=0, high=100_000
    )
    # further attempts
    attempts: int = option(
        5,
        'maximum number of registrations of a doubtful pair, each done differently',
        low=1,
        high=5,
    )
    sure: float = option(
        0.8, 'confidence at which register() makes no further attempt', low=0.0, high=1.0
    )

    def __post_init__(self) -> None:
        """Check ranges and that the widths fit the groups and heads.

        Raises:
            ConfigError: names the field, what was expected and what was found.
        """
        validate(self)
        if len(self.widths) != 4:
            raise ConfigError(f'widths: expected 4 numbers, found {len(self.widths)}')
        for width in (self.stem, *self.widths):
            if width % (self.groups * self.bottleneck) and width % self.groups:
                raise ConfigError(
                    f'widths: expected multiples of groups={self.groups}, found {width}'
                )
        if self.dim % (2 * self.heads):
            raise ConfigError(
                f'dim: expected a multiple of 2*heads={2 * self.heads}, found {self.dim}'
            )

    @classmethod
    def profile(cls, name: str) -> ModelConfig:
        """A named profile: `compact` (shipped, two CPU cores) or `paper` (for a GPU).

        Raises:
            ConfigError: no such profile.
        """
        if name == 'compact':
            return cls(voxel_factor=1.3, top_pairs=48)
        if name == 'paper':
            return cls(
                max_superpoints=2048,
                neighbours=36,
                stem=64,
                widths=(128, 256, 512, 1024),
                groups=32,
                kernel_radius=2.5,
                kernel_extent=2.0,
                fine_dim=256,
                dim=256,
                sigma_distance=6.67,
                angle_reduction='max',
                mask_outputs=1,
                mask_exponent=1.0,
                pair_temperature=0.5,
                patch_size=64,
                sinkhorn_iterations=100,
                acceptance_radius=3.33,
            )
        raise ConfigError(f'profile: expected compact or paper, found {name!r}')

    @property
    def levels(self) -> int:
        """Number of pyramid levels."""
        return len(self.widths)
