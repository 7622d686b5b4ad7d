# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""From matches to a pose: hypotheses, verification, refinement, confidence, retries."""
