"""Reading back what the store remembers, after a restart."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence

from rsu_app.ports import ArrivalKey, CountablePassage, PassageStore

PORTION_COUNT = 250
"""Passages that are read back at once: meanwhile nobody is answered, so they are few."""


class Restoring:
    """Hands out stored passages in portions, the newest first: what is true now comes before what was.

    If the store fails, or whoever asked has enough for now, the next attempt goes on where this one stopped.

    Args:
        store: Remembers.
        limit_count: Passages that are read back, all in all.
    """

    def __init__(self, store: PassageStore, *, limit_count: int) -> None:
        self._store = store
        self._remaining_count = limit_count
        self._before: ArrivalKey | None = None

    @property
    def done(self) -> bool:
        """Whether there is nothing more to hand out."""
        return self._remaining_count <= 0

    async def portions(self, *, since_unix_s: float) -> AsyncIterator[Sequence[CountablePassage]]:
        """Yield passages received at or after a moment, the newest portion first, each portion newest first.

        Raises:
            StoreError: The store cannot be read.
        """
        while self._remaining_count > 0:
            limit_count = min(PORTION_COUNT, self._remaining_count)
            portion = await self._store.load(since_unix_s=since_unix_s, limit_count=limit_count, before=self._before)
            if len(portion) < limit_count:
                self._remaining_count = 0
            else:
                self._remaining_count -= limit_count
                self._before = portion[0].arrival
            yield portion[::-1]
