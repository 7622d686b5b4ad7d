# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What other sensors say about the motion: a frame on /tf, a gyroscope."""
