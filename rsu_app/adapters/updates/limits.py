"""What a visit to a repository may take."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FetchLimits:
    """What a visit may take.

    Attributes:
        silence_s: Longest wait for the next byte, and for a connection.
        total_s: Longest visit; enough for the largest bundle at 1 Mbit/s.
        bundle_bytes: Largest bundle, all files together.
        files_count: Most files of a bundle.
    """

    silence_s: float = 20.0
    total_s: float = 900.0
    bundle_bytes: int = 64 * 1024 * 1024
    files_count: int = 64
