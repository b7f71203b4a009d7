"""What a section's own traffic was like under a live bundle, by bands of friction."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import floor, isfinite, log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadgrip.units import FloatArray
from rsu_app.domain.drift import BandReference

BAND_RATIO = 1.25
"""From one band's lower edge to the next: narrower than what friction does to driving, wider than an estimate errs."""
BAND_ROWS_COUNT = 128
"""A band is learned from so many passages, then it is closed: what came first is what later traffic is held against."""
SPELL_S = 3600.0
SPELL_ROWS_COUNT = 32
"""Passages that a band takes of one hour at most: one hour has one weather and one mood of traffic."""
LEVELS_COUNT = 21


def band_of(mu: float) -> int:
    """Return the number of the band that an estimate falls into; it grows with friction."""
    return floor(log(mu) / log(BAND_RATIO))


class _OpenBand(NamedTuple):
    rows: list[NDArray[np.float32]]
    taken_count: Counter[int]


class SectionBaseline:
    """The first passages of a section under a bundle, band by band; one section, one bundle, one feature table.

    A band gathers passages of several hours until it has enough, then keeps their quantiles alone, 9 kB. Bands that
    the weather has not brought yet stay open. To be filled in the order in which passages were stored: filled with
    the same ones again after a restart it is the same.

    Args:
        band_rows_count: Passages per band.
        spell_rows_count: Passages that a band takes of one hour at most.
    """

    def __init__(self, *, band_rows_count: int = BAND_ROWS_COUNT, spell_rows_count: int = SPELL_ROWS_COUNT) -> None:
        self._band_rows_count = band_rows_count
        self._spell_rows_count = spell_rows_count
        self._open: dict[int, _OpenBand] = {}
        self._closed: dict[int, BandReference] = {}

    @property
    def bands(self) -> tuple[BandReference, ...]:
        """The bands that are learned, from the lowest friction to the highest."""
        return tuple(self._closed[number] for number in sorted(self._closed))

    @property
    def gathering_count(self) -> int:
        """Passages in bands that are not learned yet."""
        return sum(len(band.rows) for band in self._open.values())

    def add(self, *, left_at_s: float, values: Sequence[float] | NDArray[np.float32] | FloatArray, mu: float) -> bool:
        """Learn from a passage, and return whether its band had a use for it.

        Args:
            left_at_s: When the vehicle left the section; by any clock, for it only tells hours apart.
            values: Its kinematic features, finite. (k,)
            mu: Its estimate, finite and above zero.

        Raises:
            ValueError: The time or the estimate is no such number, or a value of a passage that is of use.
        """
        if not (isfinite(left_at_s) and isfinite(mu) and mu > 0.0):
            raise ValueError(f"a passage with the estimate {mu} at {left_at_s} s teaches nothing")
        number = band_of(mu)
        if number in self._closed:
            return False
        band = self._open.setdefault(number, _OpenBand([], Counter()))
        spell = floor(left_at_s / SPELL_S)
        if band.taken_count[spell] >= self._spell_rows_count:
            return False
        if not np.isfinite(values).all():
            raise ValueError("a passage whose values are no numbers teaches nothing")
        band.taken_count[spell] += 1
        band.rows.append(np.array(values, dtype=np.float32))
        if len(band.rows) >= self._band_rows_count:
            self._closed[number] = _learned(number, self._open.pop(number).rows)
        return True


def learned_bands(
    *, left_at_s: FloatArray, rows: FloatArray | NDArray[np.float32], mu: FloatArray
) -> tuple[BandReference, ...]:
    """Return the bands that are learned from passages in the order given; see `SectionBaseline.add`.

    Args:
        left_at_s: (n,)
        rows: (n, k)
        mu: (n,)
    """
    baseline = SectionBaseline()
    for at_s, values, estimate_mu in zip(left_at_s.tolist(), rows, mu.tolist(), strict=True):
        baseline.add(left_at_s=at_s, values=values, mu=estimate_mu)
    return baseline.bands


def _learned(number: int, rows: list[NDArray[np.float32]]) -> BandReference:
    at = np.linspace(0.0, 1.0, LEVELS_COUNT)
    return BandReference(
        mu_low=BAND_RATIO**number,
        mu_high=BAND_RATIO ** (number + 1),
        rows_count=len(rows),
        quantile_values=np.ascontiguousarray(np.quantile(np.array(rows), at, axis=0).T, dtype=np.float32),
    )
