"""How many of a kind in a second: the one bound for whatever a sender could otherwise cause without end."""

from __future__ import annotations

from collections import OrderedDict


class RateLimit:
    """So many in a second, as many of which may be saved up for a burst.

    Args:
        limit_per_s: How many in a second; 0 allows none.
    """

    def __init__(self, limit_per_s: float) -> None:
        self._limit_per_s = limit_per_s
        self._capacity = max(1.0, limit_per_s) if limit_per_s > 0.0 else 0.0
        self._left = self._capacity
        self._at_s: float | None = None

    def take(self, *, now_s: float) -> bool:
        """Return whether one more is allowed, and count it if so.

        Args:
            now_s: Any monotonic clock, the same at every call.
        """
        elapsed_s = 0.0 if self._at_s is None else now_s - self._at_s
        self._at_s = now_s
        self._left = min(self._capacity, self._left + elapsed_s * self._limit_per_s)
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class RateLimitEach:
    """A `RateLimit` for each of many senders, in bounded memory.

    Args:
        limit_per_s: How many each may in a second.
        kept_count: Senders that are remembered; who was silent longest is forgotten, and then starts anew.
    """

    def __init__(self, limit_per_s: float, *, kept_count: int = 4_096) -> None:
        self._limit_per_s = limit_per_s
        self._kept_count = kept_count
        self._limits: OrderedDict[str, RateLimit] = OrderedDict()

    def __len__(self) -> int:
        """Return how many senders are remembered."""
        return len(self._limits)

    def take(self, sender: str, *, now_s: float) -> bool:
        """Return whether one more of a sender is allowed, and count it if so; see `RateLimit.take`."""
        limit = self._limits.get(sender)
        if limit is None:
            limit = self._limits[sender] = RateLimit(self._limit_per_s)
            if len(self._limits) > self._kept_count:
                self._limits.popitem(last=False)
        else:
            self._limits.move_to_end(sender)
        return limit.take(now_s=now_s)
