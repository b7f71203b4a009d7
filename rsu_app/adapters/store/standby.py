"""A store that could not be opened yet, and tries again: a unit whose disk is full or missing still has a job to do."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence

from roadgrip.errors import StoreError
from roadgrip.ledger import Action, LedgerEntry
from rsu_app.ports import CountablePassage, PassageEntry, PassageStore, StoreCounts, StoredEstimate

RETRY_PERIOD_S = 5.0
"""Between two attempts to open; in between, whoever asks is told why the last one failed."""


class StandbyStore:
    """Stands where the store should, fails with the reason, and hands over once the store can be opened.

    See `rsu_app.ports.PassageStore` for what each method promises.

    Args:
        open_now: Opens the real store or raises StoreError.
        problem: Why that failed just now.
        now_s: A monotonic clock.
    """

    def __init__(
        self, open_now: Callable[[], PassageStore], *, problem: StoreError, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._open_now = open_now
        self._problem = str(problem)
        self._now_s = now_s
        self._tried_at_s = now_s()
        self._store: PassageStore | None = None
        self._opening = asyncio.Lock()

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know about how the store was opened."""
        if self._store is None:
            return (f"the store could not be opened: {self._problem}",)
        return (*self._store.notes, f"the store could be opened only later; at first: {self._problem}")

    async def append(self, entry: PassageEntry) -> StoredEstimate | None:
        """Return after the commit that holds the entry; what was held already instead, if so."""
        return await (await self._opened()).append(entry)

    async def load(self, *, since_unix_s: float, limit_count: int) -> Sequence[CountablePassage]:
        """Return what was received at or after a moment, oldest first."""
        return await (await self._opened()).load(since_unix_s=since_unix_s, limit_count=limit_count)

    async def load_first(self, *, section_id: str, bundle_id: str, limit_count: int) -> Sequence[CountablePassage]:
        """Return the first passages of a section that a bundle judged and that are still kept, in their order."""
        store = await self._opened()
        return await store.load_first(section_id=section_id, bundle_id=bundle_id, limit_count=limit_count)

    async def compared_count(self, *, bundle_id: str, shadow_bundle_id: str) -> int:
        """Return for how many stored passages one bundle was live and another answered beside it."""
        store = await self._opened()
        return await store.compared_count(bundle_id=bundle_id, shadow_bundle_id=shadow_bundle_id)

    async def record(
        self,
        *,
        at_unix_s: float,
        actor: str,
        action: Action,
        subject: str,
        reason: str,
        evidence: Mapping[str, str] | None = None,
    ) -> LedgerEntry:
        """Return the entry that was appended to the ledger, after the commit that holds it."""
        return await (await self._opened()).record(
            at_unix_s=at_unix_s, actor=actor, action=action, subject=subject, reason=reason, evidence=evidence
        )

    async def ledger(self, *, limit_count: int) -> Sequence[LedgerEntry]:
        """Return the newest entries of the ledger, newest first."""
        return await (await self._opened()).ledger(limit_count=limit_count)

    async def counts(self) -> StoreCounts:
        """Return how full the store is."""
        return await (await self._opened()).counts()

    async def probe(self) -> None:
        """Return once a write is known to have reached the disk a short while ago, or now."""
        await (await self._opened()).probe()

    async def prune(self, *, before_unix_s: float | None, rows_limit_count: int) -> int:
        """Delete what is too old, then the oldest beyond the limit."""
        return await (await self._opened()).prune(before_unix_s=before_unix_s, rows_limit_count=rows_limit_count)

    async def close(self) -> None:
        """Close the real store, if there is one by now."""
        async with self._opening:
            if self._store is not None:
                await self._store.close()

    async def _opened(self) -> PassageStore:
        async with self._opening:
            if self._store is None:
                await self._try()
            if self._store is None:
                raise StoreError(self._problem)
            return self._store

    async def _try(self) -> None:
        if self._now_s() - self._tried_at_s < RETRY_PERIOD_S:
            return
        try:
            self._store = await asyncio.to_thread(self._open_now)
        except StoreError as error:
            self._problem = str(error)
        self._tried_at_s = self._now_s()
