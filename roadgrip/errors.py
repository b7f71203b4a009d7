"""The tree of broken promises.

Expected outcomes (a summary that comes too late, a passage outside the training envelope) are values, see
`roadgrip.records`. What stands here means that somebody broke a promise::

    RoadgripError
    |-- SectionError         a road geometry or section file that cannot be used
    |-- TraceError           a recording that is not a trace
    |-- WireError            bytes that are not a message; carries the reason code that the sender sees
    |-- FeatureTableError    two feature tables that should be one
    |-- BundleError          a model bundle that must not be trusted
    |-- StoreError           the passage store cannot do what it must
    |   |-- StoreFullError     its queue or its disk has no room
    |   `-- StoreDamagedError  what it has written is no longer what it wrote
    `-- ConfigurationError   settings that contradict themselves or the machine

The tree knows no transport: one table in the HTTP adapter maps it to status codes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from roadgrip.reasons import Reason


class RoadgripError(Exception):
    """Root of the tree."""


class SectionError(RoadgripError):
    """A road geometry or section file that cannot be used; the message says what to change."""


class TraceError(RoadgripError):
    """A recording that is not a trace: a missing channel, unequal lengths, an impossible sampling rate."""


class WireError(RoadgripError):
    """Bytes that are not a message of ours.

    Attributes:
        reason: The code the sender sees and the metric counts.
    """

    def __init__(self, reason: Reason, detail: str) -> None:
        """Keep the reason beside the detail meant for a person."""
        super().__init__(f"{reason.value}: {detail}")
        self.reason = reason
        self.detail = detail


class FeatureTableError(RoadgripError):
    """Two feature tables that should be one; the message names both digests."""


class BundleError(RoadgripError):
    """A model bundle that must not be trusted; the message says which check failed."""


class StoreError(RoadgripError):
    """The passage store cannot do what it must; nothing was acknowledged."""


class StoreFullError(StoreError):
    """The store's queue or its disk has no room; try again later."""


class StoreDamagedError(StoreError):
    """What the store has written is no longer what it wrote; it goes on only with another file."""


class ConfigurationError(RoadgripError):
    """Settings that contradict themselves or the machine."""
