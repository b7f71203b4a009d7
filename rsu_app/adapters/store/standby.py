"""A store that cannot be opened, or no longer: a unit whose disk is full, missing or spoilt still has a job to do."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import TypeVar

from roadgrip.errors import StoreDamagedError, StoreError
from roadgrip.ledger import Action, LedgerEntry
from rsu_app.ports import (
    NO_WRITER,
    ArrivalKey,
    CountablePassage,
    PassageEntry,
    PassageStore,
    StoreCounts,
    StoredEstimate,
    WriterPulse,
)

T = TypeVar("T")

RETRY_PERIOD_S = 5.0
"""Between two attempts to open; in between, whoever asks is told why the last one failed."""


class StandbyStore:
    """Stands where the store should while there is none: fails with the reason, and hands over once one can be opened.

    A store whose file turns out to be damaged is put away and opened again, which moves the file aside.
    See `rsu_app.ports.PassageStore` for what each method promises.

    Args:
        store: The real one, or why it could not be opened just now.
        open_again: Opens it or raises StoreError.
        now_s: A monotonic clock.
    """

    def __init__(
        self,
        store: PassageStore | StoreError,
        *,
        open_again: Callable[[], PassageStore],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._open_again = open_again
        self._now_s = now_s
        self._tried_at_s = now_s()
        self._store = None if isinstance(store, StoreError) else store
        self._problem = str(store) if isinstance(store, StoreError) else ""
        self._opening = asyncio.Lock()

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know about how the store was opened."""
        if self._store is None:
            return (f"the store could not be opened: {self._problem}",)
        if self._problem:
            return (*self._store.notes, f"the store could be opened only later; at first: {self._problem}")
        return self._store.notes

    @property
    def pulse(self) -> WriterPulse:
        """What can be seen of the real store's writer, if there is one by now; never waits."""
        return NO_WRITER if self._store is None else self._store.pulse

    async def append(self, entries: Sequence[PassageEntry]) -> list[StoredEstimate | None]:
        """Return after the commit that holds the entries; for each what was held already instead, if so."""
        return await self._ask(lambda store: store.append(entries))

    async def load(
        self, *, since_unix_s: float, limit_count: int, before: ArrivalKey | None = None
    ) -> Sequence[CountablePassage]:
        """Return what was received at or after a moment, oldest first."""
        return await self._ask(
            lambda store: store.load(since_unix_s=since_unix_s, limit_count=limit_count, before=before)
        )

    async def load_first(self, *, section_id: str, bundle_id: str, limit_count: int) -> Sequence[CountablePassage]:
        """Return the first passages of a section that a bundle judged and that are still kept, in their order."""
        return await self._ask(
            lambda store: store.load_first(section_id=section_id, bundle_id=bundle_id, limit_count=limit_count)
        )

    async def compared_count(self, *, bundle_id: str, shadow_bundle_id: str) -> int:
        """Return for how many stored passages one bundle was live and another answered beside it."""
        return await self._ask(
            lambda store: store.compared_count(bundle_id=bundle_id, shadow_bundle_id=shadow_bundle_id)
        )

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
        return await self._ask(
            lambda store: store.record(
                at_unix_s=at_unix_s, actor=actor, action=action, subject=subject, reason=reason, evidence=evidence
            )
        )

    async def ledger(self, *, limit_count: int) -> Sequence[LedgerEntry]:
        """Return the newest entries of the ledger, newest first."""
        return await self._ask(lambda store: store.ledger(limit_count=limit_count))

    async def counts(self) -> StoreCounts:
        """Return how full the store is."""
        return await self._ask(lambda store: store.counts())

    async def probe(self) -> None:
        """Return once a write is known to have reached the disk a short while ago, or now."""
        await self._ask(lambda store: store.probe())

    async def prune(self, *, before_unix_s: float | None, rows_limit_count: int) -> int:
        """Delete what is too old, then the oldest beyond the limit."""
        return await self._ask(
            lambda store: store.prune(before_unix_s=before_unix_s, rows_limit_count=rows_limit_count)
        )

    async def close(self) -> None:
        """Close the real store, if there is one by now."""
        async with self._opening:
            if self._store is not None:
                await self._store.close()

    async def _ask(self, question: Callable[[PassageStore], Awaitable[T]]) -> T:
        store = self._store or await self._opened()
        try:
            return await question(store)
        except StoreDamagedError as error:
            await self._put_away(store, str(error))
            raise

    async def _put_away(self, store: PassageStore, problem: str) -> None:
        """Let go of a store whose file is damaged; the next question opens it again, unless it was opened just now."""
        async with self._opening:
            if self._store is store:
                self._store, self._problem = None, problem
                await store.close()

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
            self._store = await asyncio.to_thread(self._open_again)
        except StoreError as error:
            self._problem = str(error)
        self._tried_at_s = self._now_s()
