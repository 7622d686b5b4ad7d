# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Alignment of a scan with the local map, its covariance, and kiss-icp."""
