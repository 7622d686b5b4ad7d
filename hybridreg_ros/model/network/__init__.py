# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The network in use, compiled: backbone, geometric transformer, mask and matching on arrays."""
