"""What the use cases need from the world, and the records that cross the border.

Adapters implement these protocols; tests implement them with fakes that are real code.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from roadgrip.bundle import BundleManifest
from roadgrip.ledger import Action, LedgerEntry
from roadgrip.records import NotCounted, Passage
from roadgrip.units import FloatArray


class Clock(Protocol):
    """Two readings of time: one that never jumps, one that people share."""

    def monotonic_s(self) -> float:
        """Return seconds since an arbitrary moment; never goes back, never jumps."""
        ...

    def unix_s(self) -> float:
        """Return seconds since 1970 by the wall clock, which may be wrong and may step."""
        ...


@dataclass(frozen=True, slots=True)
class Estimates:
    """What the models for one feature table answered.

    Attributes:
        mu: The friction of each row. (n,)
        expected_error_ratio: The error to expect of each, relative to it; None without a model for it. (n,)
    """

    mu: FloatArray
    expected_error_ratio: FloatArray | None


class FrictionModel(Protocol):
    """The models of a bundle, one per feature table it serves, with everything needed to trust them."""

    @property
    def manifest(self) -> BundleManifest:
        """What the bundle says about itself."""
        ...

    def estimate(self, table_digest: str, rows: FloatArray, *, section_id: str | None = None) -> Estimates:
        """Return the friction estimate of each row, and its expected error.

        Args:
            table_digest: One of the feature tables the bundle serves.
            rows: Features in the order of that table. (n, columns)
            section_id: Where they were driven: the section's own model answers if the bundle has one, else the global.

        Raises:
            BundleError: The bundle has no model for this table, or it does not answer.
            ValueError: A row holds a value that no passage can have; the model would answer with a plausible number.
        """
        ...


@dataclass(frozen=True, slots=True)
class StoredEstimate:
    """What the unit remembers of a passage: what was made of it, and enough to recognise a repetition.

    Attributes:
        passage_id: The passage's own id.
        section_id: The section that was driven.
        content_digest: Digest of everything the sender said, except the age, which differs at every attempt.
        values_digest: Digest of the summary's values alone; equal under two ids means that one copied the other.
        mu: The estimate, or None when the model gave no number.
        flags: Why it does not count, if it does not.
        left_unix_s: When the vehicle left the section, by the unit's wall clock.
        bundle_id: The bundle whose model for the summary's table gave the estimate.
        expected_error_ratio: Size of the error to expect, relative to the estimate; None when the bundle does not say.
        mu_low: Below this the friction hardly is; None when the bundle does not say.
        at_least: The passage only says that the friction is at least `mu_low`.
        shadow_bundle_id: The bundle that was asked beside it; None without one.
        shadow_mu: What that one said; None without an answer.
    """

    passage_id: bytes
    section_id: str
    content_digest: bytes
    values_digest: bytes
    mu: float | None
    flags: NotCounted
    left_unix_s: float
    bundle_id: str
    expected_error_ratio: float | None = None
    mu_low: float | None = None
    at_least: bool = False
    shadow_bundle_id: str | None = None
    shadow_mu: float | None = None


ArrivalKey: TypeAlias = tuple[float, int]
"""When a stored passage was received, by the wall clock, and its running number: the order of arrival."""


@dataclass(frozen=True, slots=True, eq=False)
class CountablePassage:
    """What a window takes from a passage: what was made of it, and the values that tell more than that.

    Attributes:
        estimate: What was made of it.
        table_digest: The feature table of its values; one from the store may be older than this software knows.
        values: The summary's values as they were judged, in the order of that table. (n,)
        arrival: Its place in the store; None for one that did not come from there.
    """

    estimate: StoredEstimate
    table_digest: str
    values: NDArray[np.float32]
    arrival: ArrivalKey | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PassageEntry:
    """What the store keeps for good: the passage as it came, when it came, and what was made of it.

    Attributes:
        passage: As it came.
        values: The summary's values as they were judged: in 32 bits. (k,)
        received_unix_s: When, by the unit's wall clock.
        estimate: What was made of it.
    """

    passage: Passage
    values: NDArray[np.float32]
    received_unix_s: float
    estimate: StoredEstimate

    @property
    def countable(self) -> CountablePassage:
        """What a window takes from it."""
        return CountablePassage(self.estimate, self.passage.summary.table_digest, self.values)


@dataclass(frozen=True, slots=True)
class StoreCounts:
    """How full the store is.

    Attributes:
        passages_count: Rows in the database.
        database_bytes: Size of the database with its write-ahead log.
        queued_count: Writes that wait for the writer.
        queue_limit_count: Writes that may wait before the store says it is full.
    """

    passages_count: int
    database_bytes: int
    queued_count: int
    queue_limit_count: int


@dataclass(frozen=True, slots=True)
class WriterPulse:
    """What can be seen of the one who writes without waiting for an answer.

    Attributes:
        committed_ago_s: Time since the last commit that reached the disk; None before the first and after a failure.
        busy_s: How long the same writes have been under way; 0 while there is nothing to write, infinity if nobody
            writes any more.
        queued_count: Writes that wait.
    """

    committed_ago_s: float | None
    busy_s: float
    queued_count: int


NO_WRITER = WriterPulse(committed_ago_s=None, busy_s=0.0, queued_count=0)
"""While there is no database there is nothing to write, and nobody who could be stuck in it."""


class PassageStore(Protocol):
    """Keeps passages through power cuts."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know about how the store was opened, such as a corrupt file that was moved aside."""
        ...

    @property
    def pulse(self) -> WriterPulse:
        """What can be seen of the one who writes right now; never waits."""
        ...

    async def append(self, entries: Sequence[PassageEntry]) -> list[StoredEstimate | None]:
        """Return after the one commit that holds all entries.

        Args:
            entries: At least one.

        Returns:
            For each entry None if it is stored now. Otherwise it was not stored, and this is what the store already
            holds, from before or from an entry ahead of it, under the same passage id or, failing that, with the
            same values.

        Raises:
            StoreFullError: The queue or the disk has no room.
            StoreError: The commit failed. None of the entries is stored.
        """
        ...

    async def load(
        self, *, since_unix_s: float, limit_count: int, before: ArrivalKey | None = None
    ) -> Sequence[CountablePassage]:
        """Return what was received at or after a moment, oldest first; the newest `limit_count` of it.

        Args:
            since_unix_s: By the unit's wall clock at that time.
            limit_count: Passages at most: a window is read in portions, since all of it at once would take several
                times the memory it needs in the end.
            before: Only what arrived before this: `arrival` of the first passage of the portion before.

        Raises:
            StoreError: The database cannot be read.
        """
        ...

    async def load_first(self, *, section_id: str, bundle_id: str, limit_count: int) -> Sequence[CountablePassage]:
        """Return the first passages of a section that a bundle judged and that are still kept, in their order.

        Raises:
            StoreError: The database cannot be read.
        """
        ...

    async def compared_count(self, *, bundle_id: str, shadow_bundle_id: str) -> int:
        """Return for how many stored passages one bundle was live and another answered beside it.

        Raises:
            StoreError: The database cannot be read.
        """
        ...

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
        """Return the entry that was appended to the ledger, after the commit that holds it.

        Args:
            at_unix_s: When, by the unit's wall clock.
            actor: Who: a person's account, or the unit itself.
            action: What was done.
            subject: To what, such as a bundle id.
            reason: Why, for a person.
            evidence: What it rests on.

        Raises:
            StoreError: The commit failed or there is no room.
        """
        ...

    async def ledger(self, *, limit_count: int) -> Sequence[LedgerEntry]:
        """Return the newest entries of the ledger, newest first. A store that is new has one that says so.

        Raises:
            StoreError: The database cannot be read.
        """
        ...

    async def counts(self) -> StoreCounts:
        """Return how full the store is.

        Raises:
            StoreError: The database cannot be read.
        """
        ...

    async def probe(self) -> None:
        """Return once a write is known to have reached the disk a short while ago, or now.

        Raises:
            StoreError: Writing does not work.
        """
        ...

    async def prune(self, *, before_unix_s: float | None, rows_limit_count: int) -> int:
        """Delete passages received before a moment, then the oldest beyond a number of rows.

        Works in small batches between which waiting passages are written.

        Args:
            before_unix_s: None keeps all ages, for when the clock cannot be trusted.
            rows_limit_count: Rows that may stay.

        Returns:
            How many were deleted.

        Raises:
            StoreError: Deleting failed.
        """
        ...

    async def close(self) -> None:
        """Write what waits, then release the database."""
        ...
