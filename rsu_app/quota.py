"""How many passages of one section a single certificate may report: a car does not drive one curve fifty times an hour.

Whoever holds few certificates can invent few cars. That bounds what liars can do to a median, which forgives many of
them but not a majority.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import NamedTuple

HOUR_S = 3_600.0
KEPT_COUNT = 20_000
"""Certificates and sections that are remembered, some 10 MB; the one that was silent longest makes room."""


class _Report(NamedTuple):
    at_s: float
    passage_id: bytes


class PassageQuota:
    """Counts passages by certificate and section, over a rolling hour.

    A passage that is sent again is the same passage, however often a receipt was lost.

    Args:
        limit_count: Passages of a section that a certificate may report in an hour.
        kept_count: Pairs of certificate and section that are remembered.
    """

    def __init__(self, limit_count: int, *, kept_count: int = KEPT_COUNT) -> None:
        self._limit_count = limit_count
        self._kept_count = kept_count
        self._reports: OrderedDict[tuple[bytes, str], list[_Report]] = OrderedDict()

    def __len__(self) -> int:
        """Return how many pairs are remembered."""
        return len(self._reports)

    def take(self, *, certificate_id: bytes, section_id: str, passage_id: bytes, now_s: float) -> bool:
        """Return whether a passage may be reported, and count it if so.

        Args:
            certificate_id: Whose signature it carries.
            section_id: Where it was driven.
            passage_id: Which passage it is.
            now_s: Any clock that never runs backwards.
        """
        key = certificate_id, section_id
        reports = [report for report in self._reports.get(key, ()) if now_s - report.at_s < HOUR_S]
        allowed = any(report.passage_id == passage_id for report in reports)
        if not allowed and len(reports) < self._limit_count:
            reports.append(_Report(now_s, passage_id))
            allowed = True
        self._reports[key] = reports
        self._reports.move_to_end(key)
        while len(self._reports) > self._kept_count:
            self._reports.popitem(last=False)
        return allowed
