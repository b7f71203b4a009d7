"""What the driver is told now: kept here, and told to the dashboard and the CAN bus whenever it changes."""

from __future__ import annotations

import asyncio
import json
from typing import TYPE_CHECKING, Any, TypeAlias

from roadgrip.section_file import section_to_json
from vehicle_client.mapmatch.approach import Whereabouts
from vehicle_client.shell.live.dashboard import (
    HEARTBEAT_S,
    SCHEMA_VERSION,
    Dashboard,
    SectionAhead,
    ShownAdvice,
    state_line,
)

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Callable
    from pathlib import Path

    from roadgrip.records import Advisory
    from roadgrip.section import RoadSection
    from vehicle_client.mapmatch.approach import Pass
    from vehicle_client.shell.conversation import Clock
    from vehicle_client.shell.live.source import SourceState

LOOK_S = 0.1
"""Advice that has run out is withdrawn so soon."""
FRAME_S = 1.0

SendAdvice: TypeAlias = "Callable[[ShownAdvice | None, bool, float], bool]"
"""Takes advice (or that there is none any more), whether the car is inside, and now; tells whether it was sent."""


class Cockpit:
    """The driver's view."""

    def __init__(
        self,
        clock: Clock,
        *,
        source_state_of: Callable[[], SourceState],
        passes_of: Callable[[], tuple[Pass, ...]],
        map_of: Callable[[str], RoadSection | None],
        counters: Callable[[], dict[str, Any]],
        counts: Counter[str],
        send: SendAdvice | None = None,
    ) -> None:
        """Show nothing.

        Args:
            clock: By which advice runs out.
            source_state_of: Tells how the sensors are.
            passes_of: Gives the open passes.
            map_of: Gives the map of a section, if it is known.
            counters: What readers get who ask for it.
            counts: Where readers and frames are counted.
            send: Puts advice on a CAN bus, if that is wanted.
        """
        self._clock = clock
        self._source_state_of = source_state_of
        self._passes_of = passes_of
        self._map_of = map_of
        self._counters = counters
        self._counts = counts
        self._send = send
        self._dashboard = Dashboard(present=self._present, counters=self._counters_line, counts=counts)
        self._advice: dict[str, ShownAdvice] = {}
        self._told: object = None
        self._sequence_number = 0

    @property
    def advice(self) -> tuple[ShownAdvice, ...]:
        """What is shown now, the oldest first."""
        now_s = self._clock.now_s()
        return tuple(shown for shown in self._advice.values() if shown.expires_s > now_s)

    async def open(self, address: Path | tuple[str, int]) -> tuple[str, int] | Path:
        """Open the dashboard's socket and return where.

        Raises:
            ConfigurationError: The place cannot be listened on.
        """
        return await self._dashboard.open(address)

    async def close(self) -> None:
        """Send readers away."""
        await self._dashboard.close()

    def show_advice(self, section_id: str, advisory: Advisory) -> None:
        """Show advice about a section instead of earlier advice about it."""
        expires_s = self._clock.now_s() + advisory.valid_for_s
        self._advice[section_id] = ShownAdvice(section_id, advisory, expires_s)
        self.refresh()

    def withdraw(self, section_id: str) -> None:
        """Take away advice about a section, because the car has left it or never came to it."""
        self._advice.pop(section_id, None)
        self.refresh()

    def show_map(self, section: RoadSection) -> None:
        """Tell a map, when its pass begins or when it comes."""
        self._dashboard.tell(_map_line(section))

    def refresh(self) -> None:
        """Tell what has changed: where the car is, or advice that has run out."""
        advice = self.advice
        self._advice = {shown.section_id: shown for shown in advice}
        present = (self._source_state_of(), self._sections(), advice)
        if present != self._told:
            self._told = present
            self._sequence_number += 1
            self._dashboard.tell(self._state_line())

    def _sections(self) -> tuple[SectionAhead, ...]:
        return tuple(
            SectionAhead(
                one.section_id,
                one.whereabouts.value,
                "" if (known := self._map_of(one.section_id)) is None else known.version,
            )
            for one in self._passes_of()
        )

    async def keep_going(self) -> None:
        """Withdraw what runs out, send frames and heartbeats; until cancelled."""
        heartbeat_s = frame_s = self._clock.now_s()
        shown = False
        while True:
            now_s = self._clock.now_s()
            self.refresh()
            if now_s - heartbeat_s >= HEARTBEAT_S:
                heartbeat_s = now_s
                self._dashboard.tell({"v": SCHEMA_VERSION, "type": "heartbeat", "sequence": self._sequence_number})
            if self._send is not None and now_s - frame_s >= FRAME_S:
                frame_s = now_s
                advice, inside = self._foremost()
                if advice is not None or shown:
                    sent = self._send(advice, inside, now_s)
                    self._counts["advisory_frames" if sent else "advisory_frames_failed"] += 1
                shown = advice is not None
            await asyncio.sleep(LOOK_S)

    def _foremost(self) -> tuple[ShownAdvice | None, bool]:
        """Return the one advice that fits a cluster: of the section the car is in, else the slowest."""
        inside = {s.section_id for s in self._sections() if s.whereabouts == Whereabouts.INSIDE.value}
        ordered = sorted(self.advice, key=lambda a: (a.section_id not in inside, a.advisory.speed_mps))
        return (ordered[0], ordered[0].section_id in inside) if ordered else (None, False)

    def _state_line(self) -> dict[str, Any]:
        return state_line(
            self._sections(),
            self.advice,
            source=self._source_state_of().value,
            now_s=self._clock.now_s(),
            sequence_number=self._sequence_number,
        )

    def _counters_line(self) -> dict[str, Any]:
        return {"v": SCHEMA_VERSION, "type": "counters", "counters": self._counters()}

    def _present(self) -> list[dict[str, Any]]:
        maps = [self._map_of(section.section_id) for section in self._sections()]
        return [self._state_line(), *(_map_line(section) for section in maps if section is not None)]


def _map_line(section: RoadSection) -> dict[str, Any]:
    return {
        "v": SCHEMA_VERSION,
        "type": "map",
        "section_id": section.section_id,
        "map_version": section.version,
        "section": json.loads(section_to_json(section)),
    }
