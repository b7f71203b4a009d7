"""A feature table that nobody speaks: the newest one with some columns more, as the next version will have."""

from __future__ import annotations

from dataclasses import replace

from roadgrip.features import NEWEST_TABLE, Feature

EXTRA_COUNT = 45

WIDER_TABLE = replace(
    NEWEST_TABLE,
    version=1000,
    kinematic=(
        *NEWEST_TABLE.kinematic,
        *(Feature(f"made_up_{i:02d}_ratio", "", -50.0, 50.0) for i in range(EXTRA_COUNT)),
    ),
)
"""At least 100 kinematic features, as many as a summary may hold, and everything that older tables have."""
