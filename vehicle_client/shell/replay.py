"""A recorded drive, summarised and sent as if it had just ended."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from roadgrip.errors import ConfigurationError
from roadgrip.features import KINEMATIC_FEATURES
from roadgrip.records import PASSAGE_ID_BYTES, Accepted, Rejected
from roadgrip.units import mps_to_kph
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry
from vehicle_client.mapmatch.dead_reckoning import DrivenLine, driven_line
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.recording.foreign import Recording
from vehicle_client.recording.public import COMMA2K19_RAV4, FERRARI_250LM, IAC_AV21
from vehicle_client.shell.conversation import SpedUpClock, arrive, report
from vehicle_client.shell.exchange import Ending, Exchange, ExchangeRecord, Stage
from vehicle_client.shell.fleet_events import flag_names
from vehicle_client.shell.sources import read_recording, read_trace_csv
from vehicle_client.shell.uplink import uplink_to
from vehicle_client.shell.views import advice_text

if TYPE_CHECKING:
    from pathlib import Path

    from roadgrip.section import RoadSection
    from vehicle_client.estimation.trace import Trace
    from vehicle_client.shell.keys import Keys
    from vehicle_client.shell.uplink import UnitAddress


class RecordingFormat(StrEnum):
    """Whose recording it is."""

    ROADGRIP = "roadgrip"
    """Our own CSV, see `vehicle_client.recording.channels`."""
    FERRARI_250LM = "ferrari-250lm"
    """Stanford's Revs programme: a Ferrari 250 LM."""
    IAC_AV21 = "iac-av21"
    """Indy Autonomous Challenge: an AV-21."""
    COMMA2K19_RAV4 = "comma2k19-rav4"
    """comma2k19: a Toyota RAV4."""


MAPPINGS = {
    RecordingFormat.FERRARI_250LM: FERRARI_250LM,
    RecordingFormat.IAC_AV21: IAC_AV21,
    RecordingFormat.COMMA2K19_RAV4: COMMA2K19_RAV4,
}

SHOWN = ("speed_mean_mps", "speed_min_mps", "speed_max_mps", "steer_std_rad", "sideslip_max_rad", "sideslip_min_rad")
"""Of the 55 numbers, those a person can judge at a glance."""


@dataclass(frozen=True, slots=True)
class Replay:
    """What became of a recording.

    Attributes:
        made: What the onboard pipeline made of it.
        ended_s: End of the recording, on its own clock.
        record: How the exchange went; None if nothing was sent.
    """

    made: Summarised | Rejected
    ended_s: float
    record: ExchangeRecord | None = None

    @property
    def went_well(self) -> bool:
        """Whether there is a summary, and the unit acknowledged it if it was sent."""
        return isinstance(self.made, Summarised) and (self.record is None or self.record.ending is Ending.ACCEPTED)


def read_trace(path: Path, recording_format: RecordingFormat) -> Trace:
    """Return the trace that a file holds.

    Raises:
        ConfigurationError: The file cannot be read.
        TraceError: It is no such recording; the message says where.
    """
    return _read(path, recording_format).trace


def recorded_line(path: Path, recording_format: RecordingFormat) -> DrivenLine:
    """Return the line a recorded vehicle drove, by its yaw rate and its speed.

    The speed is a reference instrument's where the recording has one, else the mean of the wheels that do not steer.

    Raises:
        ConfigurationError: The file cannot be read.
        TraceError: It is no such recording; the message says where.
    """
    recording = _read(path, recording_format)
    trace, reference = recording.trace, recording.reference
    speed_mps = reference.get("velocity_x_mps", trace.wheel_speed_mps[:, 2:].mean(axis=1))
    return driven_line(speed_mps, trace.yaw_rate_radps, reference.get("velocity_y_mps"))


def _read(path: Path, recording_format: RecordingFormat) -> Recording:
    mapping = MAPPINGS.get(recording_format)
    try:
        if mapping is None:
            return Recording(trace=read_trace_csv(path), reference={}, missing=())
        return read_recording(path, mapping)
    except OSError as error:
        raise ConfigurationError(f"cannot read {path}: {error.strerror or error}") from error


def vehicle_of(recording_format: RecordingFormat) -> VehicleGeometry:
    """Return the car that a format's recordings come from; for our own, the car of the paper."""
    mapping = MAPPINGS.get(recording_format)
    return XC90 if mapping is None else mapping.vehicle


def summarise_recording(trace: Trace, section: RoadSection, *, vehicle: VehicleGeometry = XC90) -> Replay:
    """Return what the onboard pipeline makes of a recording, before anything is sent.

    Args:
        trace: The recording.
        section: The map to find in it.
        vehicle: The car that was driven.

    Raises:
        TraceError: The recording's arrays do not fit each other.
    """
    return Replay(summarise_passage(trace, section, vehicle=vehicle), ended_s=float(trace.time_s[-1]))


async def send_recorded(replay: Replay, section: RoadSection, address: UnitAddress, keys: Keys) -> Replay:
    """Return the replay with the unit's answer; nothing is sent where there is no summary.

    The passage's age is what passed in the recording after the end of the section.
    """
    if isinstance(replay.made, Rejected):
        return replay
    clock = SpedUpClock()
    passage_id = secrets.token_bytes(PASSAGE_ID_BYTES)
    exchange = Exchange(
        passage_id=passage_id,
        section_id=section.section_id,
        codec=keys.codecs_for(section.section_id)(passage_id),
        known_section=section,
    )
    async with uplink_to(address) as uplink:
        await arrive(exchange, uplink, clock)
        if exchange.stage is not Stage.ENDED:
            left_at_s = clock.now_s() - (replay.ended_s - replay.made.left_at_s)
            await report(exchange, uplink, clock, replay.made.summary, map_version=section.version, left_at_s=left_at_s)
    return replace(replay, record=exchange.record())


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


def replay_to_json(replay: Replay) -> dict[str, Any]:
    """Return the replay as JSON shows it."""
    record = replay.record
    return {
        "went_well": replay.went_well,
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
    }


def replay_table(replay: Replay) -> Table:
    """Return the replay as a table for a person."""
    table = Table("what", "value", title="The recording", title_justify="left", show_header=False)
    made, record = replay.made, replay.record
    if isinstance(made, Rejected):
        table.add_row("no passage", refusal_text(made))
        return table
    match = made.match
    table.add_row(
        "found by", f"{match.method.value}, confidence {match.confidence_frac:.2f}, {match.position_std_m:.1f} m"
    )
    table.add_row("inside the section", f"from {match.entry_s:.2f} to {match.exit_s:.2f} s of the recording")
    table.add_row("quality", ", ".join(_quality_names(made)) or "nothing to remark")
    values = dict(zip((f.name for f in KINEMATIC_FEATURES), made.summary.values, strict=True))
    for name in SHOWN:
        table.add_row(name, _readable(name, values[name]))
    table.add_row("summary", f"{len(values)} numbers, feature table {made.summary.table_digest} (all with --json)")
    if record is None:
        table.add_row("receipt", "nothing was sent")
    else:
        table.add_row("advice on arrival", advice_text(record.advisory))
        table.add_row("receipt", receipt_text(record))
        table.add_row("frames", f"{record.frames_sent_count} sent, {record.frames_received_count} received")
    return table


def made_to_json(made: Summarised | Rejected) -> dict[str, Any]:
    """Return what the pipeline made of a trace as JSON shows it."""
    if isinstance(made, Rejected):
        return {"refusal": {"reason": made.reason.value, "detail": made.detail}}
    return {
        "values": {f.name: value for f, value in zip(KINEMATIC_FEATURES, made.summary.values, strict=True)},
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
