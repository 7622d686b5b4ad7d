# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What depends on the geometry of one cloud alone: voxels, neighbours, normals, views."""
