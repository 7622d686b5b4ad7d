# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""HybridMatch: pairs of clouds in which things move, and the splits made of them."""
