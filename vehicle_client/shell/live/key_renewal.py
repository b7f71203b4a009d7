"""New pseudonyms, authorities and lists of revoked certificates are gone by as soon as they are brought."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from roadgrip.errors import ConfigurationError

if TYPE_CHECKING:
    from vehicle_client.shell.keys import Keys
    from vehicle_client.shell.live.attendance import Tools
    from vehicle_client.shell.live.journal import Journal

KEYS_PERIOD_S = 60.0


async def keep_renewing(keys: Keys, tools: Tools, journal: Journal, *, period_s: float = KEYS_PERIOD_S) -> None:
    """Look at the files of the keys again and again; those that cannot be used are counted, and change nothing."""
    while True:
        await asyncio.sleep(period_s)
        try:
            journal.counts["keys_renewed"] += await tools.work(keys.renew)
        except ConfigurationError as error:
            journal.counts["keys_unreadable"] += 1
            journal.say({"event": "keys_unreadable", "what": str(error)})
