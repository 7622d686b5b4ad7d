# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Methods without a network, as an outside measure of how difficult pairs are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import DependencyError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hybridreg_ros.data.pair import PointPair

    F64 = NDArray[np.float64]

RANSAC_ITERATIONS = 50_000
RANSAC_CONFIDENCE = 0.999
_MISSING = "baselines need open3d and kiss-matcher: pip install 'hybridreg_ros[bench]'"


def fpfh(pair: PointPair) -> F64:
    """FPFH features and RANSAC of Open3D, with the parameters of its tutorial and 50,000 samples.

    With v the pair's voxel: clouds thinned to v, normals within 2 v (30 neighbours), features
    within 5 v (100 neighbours), mutual nearest features, samples of 3, edge lengths within 0.9,
    inliers within 1.5 v, 50,000 iterations (usual on 3DMatch) or confidence 0.999; always the
    same random numbers. Where too few features are mutual Open3D takes all of them.

    Returns:
        T_target_source (4, 4).

    Raises:
        DependencyError: Open3D is not installed.
    """
    try:
        import open3d
    except ImportError:
        raise DependencyError(_MISSING) from None
    v = pair.voxel_size_m
    open3d.utility.random.seed(0)
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    clouds, features = zip(
        *(_features(open3d, p, v) for p in (pair.source, pair.target)), strict=True
    )
    r: Any = open3d.pipelines.registration
    found = r.registration_ransac_based_on_feature_matching(
        *clouds,
        *features,
        True,
        1.5 * v,
        r.TransformationEstimationPointToPoint(False),
        3,
        [
            r.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            r.CorrespondenceCheckerBasedOnDistance(1.5 * v),
        ],
        r.RANSACConvergenceCriteria(RANSAC_ITERATIONS, RANSAC_CONFIDENCE),
    )
    return np.array(found.transformation, dtype=np.float64)


def _features(open3d: Any, points: NDArray[np.float32], v: float) -> tuple[Any, Any]:
    """Thinned cloud with normals, and its features."""
    o3d = open3d.geometry
    cloud = o3d.PointCloud(open3d.utility.Vector3dVector(points.astype(np.float64)))
    cloud = cloud.voxel_down_sample(v)
    cloud.estimate_normals(o3d.KDTreeSearchParamHybrid(2.0 * v, 30))
    cloud.orient_normals_towards_camera_location()
    compute = open3d.pipelines.registration.compute_fpfh_feature
    return cloud, compute(cloud, o3d.KDTreeSearchParamHybrid(5.0 * v, 100))


def kiss_matcher(pair: PointPair) -> F64:
    """KISS-Matcher with its own defaults at the pair's voxel.

    Returns:
        T_target_source (4, 4); the identity where it finds nothing.

    Raises:
        DependencyError: KISS-Matcher is not installed.
    """
    try:
        import kiss_matcher as km
    except ImportError:
        raise DependencyError(_MISSING) from None
    matcher = km.KISSMatcher(km.KISSMatcherConfig(pair.voxel_size_m))
    found = matcher.estimate(pair.source, pair.target)
    R, t = np.array(found.rotation, np.float64), np.array(found.translation, np.float64)
    return se3.transform(R, t.reshape(3)) if np.isfinite(R).all() else np.eye(4)


METHODS: dict[str, Callable[[PointPair], F64]] = {'fpfh': fpfh, 'kiss-matcher': kiss_matcher}
