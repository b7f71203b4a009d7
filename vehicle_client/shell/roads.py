"""Where a vehicle gets the map of a section from: the package, a file, or the unit itself over the air."""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING

from roadgrip.errors import ConfigurationError
from roadgrip.records import PASSAGE_ID_BYTES, Rejected
from vehicle_client.shell.conversation import SpedUpClock, arrive
from vehicle_client.shell.exchange import Exchange
from vehicle_client.shell.patience import Patience

if TYPE_CHECKING:
    from collections.abc import Callable

    from roadgrip.section import RoadSection
    from vehicle_client.shell.exchange import FrameCodec
    from vehicle_client.shell.uplink import Uplink

FROM_UNIT_PREFIX = "rsu:"
"""`rsu:long-turn` means: ask the unit for the map of long-turn."""
MAP_PATIENCE = Patience(longest_s=1.0)
"""A person waits for this answer."""


async def ask_for_section(
    section_id: str,
    *,
    uplink: Uplink,
    open_codec: Callable[[bytes], FrameCodec],
    patience: Patience = MAP_PATIENCE,
) -> RoadSection:
    """Return the map of a section as the unit sends it to a vehicle that arrives.

    Raises:
        ConfigurationError: The unit did not send one; the message says what it answered, if anything.
    """
    passage_id = secrets.token_bytes(PASSAGE_ID_BYTES)
    exchange = Exchange(passage_id=passage_id, section_id=section_id, codec=open_codec(passage_id), patience=patience)
    await arrive(exchange, uplink, SpedUpClock())
    if exchange.section is None:
        outcome = exchange.record().outcome
        answer = "it did not answer; is it running there?"
        if isinstance(outcome, Rejected):
            answer = f"{outcome.reason.value}: {outcome.detail}".rstrip(": ")
        raise ConfigurationError(f"the unit sent no map of {section_id!r}: {answer}")
    return exchange.section
