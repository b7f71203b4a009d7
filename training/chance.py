"""Sources of chance, one for each purpose: what is drawn for one run never moves what is drawn for another."""

from __future__ import annotations

import hashlib

import numpy as np


def chance(seed: int, purpose: str) -> np.random.Generator:
    """Return the source of chance for one purpose of a design, such as one run."""
    entropy = hashlib.sha256(f"{seed}|{purpose}".encode()).digest()[:16]
    return np.random.default_rng(int.from_bytes(entropy, "big"))
