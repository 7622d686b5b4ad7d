# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The network itself: backbone, geometric transformer, mask, superpoint and point matching."""
