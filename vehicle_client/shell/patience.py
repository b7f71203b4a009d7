"""How long a vehicle waits for a road side unit, and how often it tries."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class Patience:
    """How long a vehicle waits and how often it tries.

    The tries leave frames of the budget for the spool: four arrivals and five reports of one frame each spend nine
    of twelve. Every announcement may cost the unit a map and an advisory of its eight frames, so the last one waits
    until a slow answer would have come.

    Attributes:
        reply_s: Wait for an answer before the second try.
        backoff_ratio: Each further wait is longer by this.
        longest_s: No wait is longer.
        postpone_s: Wait after "busy" and its like, growing in the same way.
        arrival_tries_count: How often an arrival is announced.
        report_tries_count: How often a summary is sent before the exchange ends without a receipt.
    """

    reply_s: float = 0.5
    backoff_ratio: float = 3.0
    longest_s: float = 6.0
    postpone_s: float = 2.0
    arrival_tries_count: int = 4
    report_tries_count: int = 5

    def stretched(self, ratio: float) -> Patience:
        """Return the same patience on a clock that runs `ratio` times as fast."""
        return replace(
            self,
            reply_s=self.reply_s * ratio,
            longest_s=self.longest_s * ratio,
            postpone_s=self.postpone_s * ratio,
        )

    def wait_s(self, first_s: float, *, tries_count: int) -> float:
        """Return how long to wait after the `tries_count`-th try, when the first wait is `first_s`."""
        return min(max(self.longest_s, first_s), first_s * self.backoff_ratio ** (tries_count - 1))
