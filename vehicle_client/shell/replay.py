"""A recorded drive, summarised and sent as if it had just ended."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from roadgrip.features import TABLES
from roadgrip.records import PASSAGE_ID_BYTES, Accepted, Reason, Rejected
from roadgrip.units import mps_to_kph
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.shell.conversation import SpedUpClock, arrive, report
from vehicle_client.shell.exchange import Ending, Exchange, ExchangeRecord, Stage
from vehicle_client.shell.fleet_events import flag_names
from vehicle_client.shell.roads import ask_for_section
from vehicle_client.shell.views import advice_text
from vehicle_client.vehicle_profile import PAPER_VEHICLE, VehicleProfile

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.table import Table

    from roadgrip.section import RoadSection
    from vehicle_client.estimation.grip.memory import CarMemory
    from vehicle_client.estimation.trace import Trace
    from vehicle_client.shell.exchange import FrameCodec
    from vehicle_client.shell.uplink import Uplink


SHOWN = ("speed_mean_mps", "speed_min_mps", "speed_max_mps", "steer_std_rad", "sideslip_max_rad", "sideslip_min_rad")
"""Of the 55 numbers, those a person can judge at a glance."""


@dataclass(frozen=True, slots=True)
class Replay:
    """What became of a recording.

    Attributes:
        made: What the onboard pipeline made of it.
        ended_s: End of the recording, on its own clock.
        section: The map it was made with.
        record: How the exchange went; None if nothing was sent.
        remapped: Whether the unit had a newer map than the one at hand.
    """

    made: Summarised | Rejected
    ended_s: float
    section: RoadSection
    record: ExchangeRecord | None = None
    remapped: bool = False

    @property
    def went_well(self) -> bool:
        """Whether there is a summary, and the unit acknowledged it if it was sent."""
        return isinstance(self.made, Summarised) and (self.record is None or self.record.ending is Ending.ACCEPTED)


def summarise_recording(
    trace: Trace, section: RoadSection, *, vehicle: VehicleProfile = PAPER_VEHICLE, memory: CarMemory | None = None
) -> Replay:
    """Return what the onboard pipeline makes of a recording, before anything is sent.

    Args:
        trace: The recording.
        section: The map to find in it.
        vehicle: The car that was driven.
        memory: What it had learned of itself.

    Raises:
        TraceError: The recording's arrays do not fit each other.
    """
    made = summarise_passage(
        trace,
        section,
        vehicle=vehicle.geometry,
        parameters=vehicle.parameters,
        handling=vehicle.handling,
        noise=vehicle.noise,
        memory=memory,
    )
    return Replay(made, ended_s=float(trace.time_s[-1]), section=section)


async def send_recorded(
    replay: Replay,
    uplink: Uplink,
    open_codec: Callable[[bytes], FrameCodec],
    *,
    summarise: Callable[[RoadSection], Replay],
) -> Replay:
    """Return the replay with the unit's answer; nothing is sent where there is no summary.

    The passage's age is what passed in the recording after the end of the section. If the unit has mapped the road
    anew, its map is fetched and the recording summarised again, once.

    Args:
        replay: What was made of the recording with the map at hand.
        uplink: To the unit.
        open_codec: Makes the codec of an exchange from a passage's id.
        summarise: Makes the same of the recording with another map.

    Raises:
        ConfigurationError: The unit calls the map outdated, and does not send its own.
    """
    if isinstance(replay.made, Rejected):
        return replay
    sent, newer = await _exchanged(replay, replay.made, uplink, open_codec)
    if newer is None and _is_stale(sent):
        newer = await ask_for_section(replay.section.section_id, uplink=uplink, open_codec=open_codec)
    if newer is None:
        return sent
    again = replace(summarise(newer), remapped=True)
    if isinstance(again.made, Rejected):
        return again
    return (await _exchanged(again, again.made, uplink, open_codec))[0]


async def _exchanged(
    replay: Replay, made: Summarised, uplink: Uplink, open_codec: Callable[[bytes], FrameCodec]
) -> tuple[Replay, RoadSection | None]:
    """Return the replay with the unit's answer, or without one and with the newer map that the unit sent instead."""
    section, clock = replay.section, SpedUpClock()
    passage_id = secrets.token_bytes(PASSAGE_ID_BYTES)
    exchange = Exchange(
        passage_id=passage_id,
        section_id=section.section_id,
        codec=open_codec(passage_id),
        known_section=section,
    )
    await arrive(exchange, uplink, clock)
    if exchange.section is not None and exchange.section.version != section.version and not replay.remapped:
        return replay, exchange.section
    if exchange.stage is not Stage.ENDED:
        left_at_s = clock.now_s() - (replay.ended_s - made.left_at_s)
        await report(exchange, uplink, clock, made.summary, map_version=section.version, left_at_s=left_at_s)
    return replace(replay, record=exchange.record()), None


def _is_stale(replay: Replay) -> bool:
    outcome = None if replay.record is None else replay.record.outcome
    return isinstance(outcome, Rejected) and outcome.reason is Reason.STALE_MAP


def refusal_text(refusal: Rejected) -> str:
    """Return a reason and what goes with it, for a person."""
    return f"{refusal.reason.value}: {refusal.detail}".rstrip(": ")


def receipt_text(record: ExchangeRecord) -> str:
    """Return what the unit said about a passage, for a person."""
    outcome = record.outcome
    if isinstance(outcome, Rejected):
        return f"{record.ending.value}: {refusal_text(outcome)}"
    if isinstance(outcome, Accepted):
        if outcome.counted:
            return "accepted and counted"
        return f"accepted, not counted: {', '.join(flag_names(outcome.flags))}"
    tries = f"no receipt after {record.report_tries_count} tries"
    hint = "" if record.frames_received_count else "; nothing came back at all, is a unit running there?"
    return f"{record.ending.value}: {tries}{hint}"


def replay_to_json(replay: Replay, *, memory: CarMemory | None = None) -> dict[str, Any]:
    """Return the replay as JSON shows it, and from how many passages the car has learned if it does."""
    record = replay.record
    remembered = {} if memory is None else {"memory": {"passages_count": memory.passages_count}}
    return {
        "went_well": replay.went_well,
        "map_version": replay.section.version,
        "remapped": replay.remapped,
        "passage": made_to_json(replay.made),
        "exchange": None
        if record is None
        else {
            "passage_id": record.passage_id.hex(),
            "ending": record.ending.value,
            "reason": record.outcome.reason.value if isinstance(record.outcome, Rejected) else None,
            "counted": isinstance(record.outcome, Accepted) and record.outcome.counted,
            "not_counted": flag_names(record.outcome.flags) if isinstance(record.outcome, Accepted) else [],
            "frames_sent_count": record.frames_sent_count,
            "frames_received_count": record.frames_received_count,
            "advised_speed_mps": None if record.advisory is None else record.advisory.speed_mps,
        },
        **remembered,
    }


def replay_table(replay: Replay, *, memory: CarMemory | None = None) -> Table:
    """Return the replay as a table for a person, and from how many passages the car has learned if it does."""
    from rich.table import Table

    table = Table("what", "value", title="The recording", title_justify="left", show_header=False)
    made, record = replay.made, replay.record
    if isinstance(made, Rejected):
        table.add_row("no passage", refusal_text(made))
        return table
    if replay.remapped:
        table.add_row("map", f"the unit's own, version {replay.section.version}; yours is outdated")
    match = made.match
    table.add_row(
        "found by", f"{match.method.value}, confidence {match.confidence_frac:.2f}, {match.position_std_m:.1f} m"
    )
    table.add_row("inside the section", f"from {match.entry_s:.2f} to {match.exit_s:.2f} s of the recording")
    table.add_row("quality", ", ".join(_quality_names(made)) or "nothing to remark")
    values = dict(zip((f.name for f in TABLES[made.summary.table_digest].kinematic), made.summary.values, strict=True))
    for name in SHOWN:
        table.add_row(name, _readable(name, values[name]))
    table.add_row("summary", f"{len(values)} numbers, feature table {made.summary.table_digest} (all with --json)")
    if record is None:
        table.add_row("receipt", "nothing was sent")
    else:
        table.add_row("advice on arrival", advice_text(record.advisory))
        table.add_row("receipt", receipt_text(record))
        table.add_row("frames", f"{record.frames_sent_count} sent, {record.frames_received_count} received")
    if memory is not None:
        table.add_row("passages learned from", f"{memory.passages_count}")
    return table


def made_to_json(made: Summarised | Rejected) -> dict[str, Any]:
    """Return what the pipeline made of a trace as JSON shows it."""
    if isinstance(made, Rejected):
        return {"refusal": {"reason": made.reason.value, "detail": made.detail}}
    return {
        "values": {
            f.name: value
            for f, value in zip(TABLES[made.summary.table_digest].kinematic, made.summary.values, strict=True)
        },
        "table_digest": made.summary.table_digest,
        "duration_s": made.summary.duration_s,
        "quality": _quality_names(made),
        "match": {
            "method": made.match.method.value,
            "entry_s": made.match.entry_s,
            "exit_s": made.match.exit_s,
            "confidence_frac": made.match.confidence_frac,
            "position_std_m": made.match.position_std_m,
        },
    }


def _quality_names(made: Summarised) -> list[str]:
    return [flag.name.lower() for flag in made.summary.quality if flag.name]


def _readable(name: str, value: float) -> str:
    if name.endswith("_mps"):
        return f"{value:.2f} m/s ({mps_to_kph(value):.0f} km/h)"
    return f"{value:.4f} rad ({np.rad2deg(value):.2f} degrees)"
