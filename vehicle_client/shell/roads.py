"""Where a vehicle gets the map of a section from: the package, a file, or the unit itself over the air."""

from __future__ import annotations

import secrets
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from roadgrip.errors import ConfigurationError
from roadgrip.records import PASSAGE_ID_BYTES
from roadgrip.section_file import section_from_json
from vehicle_client.shell.conversation import SpedUpClock, converse, send_all
from vehicle_client.shell.exchange import Exchange, Stage

if TYPE_CHECKING:
    from collections.abc import Callable

    from roadgrip.section import RoadSection
    from vehicle_client.shell.exchange import FrameCodec
    from vehicle_client.shell.uplink import Uplink

FROM_UNIT_PREFIX = "rsu:"
"""`rsu:long-turn` means: ask the unit for the map of long-turn."""


def packaged_section_names() -> tuple[str, ...]:
    """Return the sections that come with the software."""
    folder = files("roadgrip") / "sections"
    return tuple(sorted(e.name.removesuffix(".json") for e in folder.iterdir() if e.name.endswith(".json")))


def load_section(text: str) -> RoadSection:
    """Return the section that a packaged name or the path of a section file names.

    Raises:
        ConfigurationError: There is no such name or file; the message lists the names.
        SectionError: The file holds no section.
    """
    if text in packaged_section_names():
        return section_from_json((files("roadgrip") / "sections" / f"{text}.json").read_text(encoding="utf-8"))
    path = Path(text)
    if not path.is_file():
        names = ", ".join(packaged_section_names())
        raise ConfigurationError(
            f"no section {text!r}: give one of {names}, the path of a section file, "
            f"or {FROM_UNIT_PREFIX}ID to ask the unit"
        )
    try:
        return section_from_json(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read {path}: {error}") from error


async def ask_for_section(section_id: str, *, uplink: Uplink, open_codec: Callable[[bytes], FrameCodec]) -> RoadSection:
    """Return the map of a section as the unit sends it to a vehicle that arrives.

    Raises:
        ConfigurationError: The unit did not send one; the message says what it answered, if anything.
    """
    clock = SpedUpClock()
    passage_id = secrets.token_bytes(PASSAGE_ID_BYTES)
    exchange = Exchange(passage_id=passage_id, section_id=section_id, codec=open_codec(passage_id))
    await send_all(exchange.begin(now_s=clock.now_s()), uplink)
    while exchange.stage is Stage.ARRIVING:
        await converse(exchange, uplink, clock, until_s=exchange.wake_at_s)
    if exchange.section is None:
        outcome = exchange.record().outcome
        answer = "it did not answer" if outcome is None else f"it answered {outcome}"
        raise ConfigurationError(f"the unit sent no map of {section_id!r}: {answer}")
    return exchange.section
