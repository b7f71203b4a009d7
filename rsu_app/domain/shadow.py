"""Two bundles asked about the same passages: how far apart they are, and whether the newer one may go on.

Only their difference is looked at: nobody tells a unit the truth. What a shadow can find is that a bundle does not
answer, takes too long, or says something quite different from the one that has been trusted so far. Whether it is
better is for the laboratory to judge, which knows the friction of its hold-outs.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum
from math import log

import numpy as np

from roadgrip.records import NotCounted
from rsu_app.domain.judgement import Judgement

KEPT_COUNT = 1_000
"""The newest comparisons that limits are judged by; bounds the memory."""


@dataclass(frozen=True, slots=True)
class ShadowPolicy:
    """How long two bundles are compared, and how far apart they may be. Differences are of ln mu.

    Attributes:
        shadow_count: Passages that a candidate answers unheard before it becomes live.
        probation_count: Passages that it is compared for afterwards.
        judged_from_count: Comparisons from which limits are judged; before them only failures count.
        median_limit_ratio: Largest magnitude of the median difference.
        spread_limit_ratio: Largest magnitude of the difference that nine passages in ten stay below.
        share_limit_frac: By how much the share of passages that name a friction, and of those that count, may differ.
        latency_limit_s: Time that nineteen answers in twenty must take less than.
        failures_limit_count: Passages that the newer bundle may leave without an answer.
    """

    shadow_count: int = 200
    probation_count: int = 200
    judged_from_count: int = 30
    median_limit_ratio: float = 0.12
    spread_limit_ratio: float = 0.4
    share_limit_frac: float = 0.3
    latency_limit_s: float = 0.02
    failures_limit_count: int = 0


@dataclass(frozen=True, slots=True)
class Answer:
    """What one bundle made of a passage.

    Attributes:
        judgement: None when it did not answer.
        took_s: How long that took.
    """

    judgement: Judgement | None
    took_s: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """How far apart two bundles are, by the passages both were asked about.

    Attributes:
        passages_count: Passages that were compared, all in all.
        fresh_count: Those of them that were compared since the unit started.
        failures_count: Passages that the newer bundle left without an answer since then.
        both_named_count: Of the newest, those for which both named a friction and count it.
        median_ratio: Median of ln(newer / older) over these; None without any.
        spread_ratio: What nine in ten of its magnitudes stay below; None without any.
        named_frac: Share of the newest passages in which the newer names a friction, minus that of the older.
        counted_frac: Share of the newest passages that the newer counts, minus that of the older.
        latency_s: What nineteen in twenty answers of the newer took less than.
    """

    passages_count: int
    fresh_count: int
    failures_count: int
    both_named_count: int
    median_ratio: float | None
    spread_ratio: float | None
    named_frac: float
    counted_frac: float
    latency_s: float


class Verdict(StrEnum):
    """What follows from a comparison."""

    GO_ON = "go_on"
    PASSED = "passed"
    FAILED = "failed"


@dataclass(slots=True)
class ShadowRecord:
    """Gathers what two bundles made of the same passages.

    Attributes:
        earlier_count: Passages that were compared before the unit was started again; they were within the limits, or
            the comparison would have ended.
        fresh_count: Passages that were compared since.
        failures_count: Passages that the newer bundle left without an answer.
    """

    earlier_count: int = 0
    fresh_count: int = 0
    failures_count: int = 0
    _rows: deque[tuple[float, bool, bool, bool, bool]] = field(default_factory=lambda: deque(maxlen=KEPT_COUNT))
    _took_s: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT_COUNT))

    def add(self, *, newer: Answer, older: Answer) -> None:
        """Remember a passage; one that the older bundle did not answer says nothing about the newer."""
        if older.judgement is None:
            return
        self.fresh_count += 1
        if newer.judgement is None:
            self.failures_count += 1
            return
        self._took_s.append(newer.took_s)
        one, other = _named_mu(newer.judgement), _named_mu(older.judgement)
        difference = log(one / other) if one is not None and other is not None else np.nan
        counts, counted = (each.flags == NotCounted.NONE for each in (newer.judgement, older.judgement))
        self._rows.append((difference, one is not None, other is not None, counts, counted))

    def comparison(self) -> Comparison:
        """Return how far apart the bundles are."""
        rows = np.array(self._rows, dtype=np.float64).reshape(-1, 5)
        differences = rows[np.isfinite(rows[:, 0]), 0]
        shares = rows[:, 1:].mean(axis=0) if len(rows) else np.zeros(4)
        known = len(differences) > 0
        return Comparison(
            passages_count=self.earlier_count + self.fresh_count,
            fresh_count=self.fresh_count,
            failures_count=self.failures_count,
            both_named_count=len(differences),
            median_ratio=float(np.median(differences)) if known else None,
            spread_ratio=float(np.quantile(np.abs(differences), 0.9)) if known else None,
            named_frac=float(shares[0] - shares[1]),
            counted_frac=float(shares[2] - shares[3]),
            latency_s=float(np.quantile(self._took_s, 0.95)) if self._took_s else 0.0,
        )


def verdict(found: Comparison, policy: ShadowPolicy, *, wanted_count: int) -> tuple[Verdict, str]:
    """Return what follows from a comparison, and why.

    Args:
        found: How far apart the bundles are.
        policy: How far they may be.
        wanted_count: Passages after which it has passed.
    """
    if found.failures_count > policy.failures_limit_count:
        return Verdict.FAILED, f"{found.failures_count} of {found.fresh_count} passages were left without an answer"
    judged = found.fresh_count >= min(policy.judged_from_count, wanted_count)
    if judged and found.fresh_count > 0:
        for sentence, beyond in _limits(found, policy):
            if beyond:
                return Verdict.FAILED, f"{sentence}, over {found.fresh_count} passages"
    if judged and found.passages_count >= wanted_count:
        return Verdict.PASSED, f"{found.passages_count} passages within every limit; {told(found)}"
    return Verdict.GO_ON, f"{found.passages_count} of {wanted_count} passages"


def told(found: Comparison) -> str:
    """Return a comparison in words."""
    if found.median_ratio is None or found.spread_ratio is None:
        return "no passage for which both name a friction"
    return (
        f"in the median {found.median_ratio:+.1%} apart, nine in ten within {found.spread_ratio:.1%}, "
        f"{1e3 * found.latency_s:.2f} ms"
    )


def _limits(found: Comparison, policy: ShadowPolicy) -> list[tuple[str, bool]]:
    median, spread = found.median_ratio or 0.0, found.spread_ratio or 0.0
    return [
        (f"it takes {1e3 * found.latency_s:.1f} ms", found.latency_s > policy.latency_limit_s),
        (f"it answers {median:+.1%} apart in the median", abs(median) > policy.median_limit_ratio),
        (f"one passage in ten is more than {spread:.1%} apart", spread > policy.spread_limit_ratio),
        (
            f"it names a friction in {found.named_frac:+.0%} of the passages",
            abs(found.named_frac) > policy.share_limit_frac,
        ),
        (f"it counts {found.counted_frac:+.0%} of the passages", abs(found.counted_frac) > policy.share_limit_frac),
    ]


def _named_mu(judged: Judgement) -> float | None:
    """Return the friction that a judgement names; None if it names none or is not to be counted."""
    named = judged.mu is not None and judged.mu > 0.0 and not judged.at_least and judged.flags == NotCounted.NONE
    return judged.mu if named else None
