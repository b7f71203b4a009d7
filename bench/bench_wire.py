"""What a passage costs on the air, in bytes and frames, and what a message costs a processor, in microseconds.

python bench/bench_wire.py             both tables, and bench/results/wire.json
python bench/bench_wire.py --sizes     the table of docs/wire.md only
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from bench.certified import NOW_UNIX_S, VERIFIER, claims_for, rightful_signer_of
from bench.measurement import ROADS, cost_s, keep_figures, parser_of, table_of
from roadgrip.exchange import FROM_UNIT, FROM_VEHICLE, message_of
from roadgrip.features import NEWEST_TABLE, TABLES
from roadgrip.frames import Complete, exchange_id_of, parse_frame, section_key_of, split_into_frames
from roadgrip.records import (
    Accepted,
    Advisory,
    AdvisoryNotice,
    AdvisoryReason,
    Arrival,
    Beacon,
    Confidence,
    FrictionInterval,
    KinematicSummary,
    MapOffer,
    Message,
    Passage,
    Receipt,
)
from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from roadgrip.units import kph_to_mps
from roadgrip.wire import decode_message, encode_message, kind_of

COLUMNS = ("ARRIVAL", "MAP", "ADVISORY", "SUMMARY", "RECEIPT", "BEACON")
EXCHANGE = COLUMNS[:5]
"""What one passage sends; a beacon is nobody's."""


def exchange_messages(section: RoadSection) -> dict[str, Message]:
    """Return the messages of a passage that goes well, and a beacon, by the name of their kind."""
    passage_id = bytes(range(16))
    values = np.random.default_rng(1).normal(size=len(NEWEST_TABLE.kinematic)).tolist()
    interval = FrictionInterval(0.36, 0.45, 0.405, 0.395, 0.415, 0.957, 57, Confidence.RECOMMENDED, 40.0, 900.0)
    reason, confidence, speed_mps = AdvisoryReason.FRICTION_INTERVAL, Confidence.RECOMMENDED, kph_to_mps(60.0)
    messages: list[Message] = [
        Arrival(passage_id, section.section_id),
        MapOffer(section, tuple(TABLES)),
        AdvisoryNotice(
            section.section_id,
            section.version,
            Advisory(speed_mps, reason, confidence, interval, 600.0),
            1_770_000_000,
        ),
        Passage(
            passage_id,
            section.section_id,
            section.version,
            KinematicSummary(tuple(values), NEWEST_TABLE.digest, 31.27),
            2.35,
        ),
        Receipt(passage_id, Accepted()),
        Beacon(section.section_id, section.version, speed_mps, reason, confidence, 600.0, 1_770_000_000),
    ]
    return {kind_of(message).name: message for message in messages}


def encoded(message: Message, section: RoadSection, *, signed: bool) -> bytes:
    """Return the bytes of a message, signed by who may say so if it is to be."""
    if not signed:
        return encode_message(message)
    return encode_message(
        message,
        signer=rightful_signer_of(message),
        exchange_id=exchange_id_of(bytes(range(16))),
        claims=claims_for(message, section_id=section.section_id, map_version=section.version),
    )


def frames_of(message: Message, section: RoadSection, *, signed: bool) -> tuple[bytes, ...]:
    """Return the frames of a message."""
    exchange_id = exchange_id_of(bytes(range(16)))
    return split_into_frames(
        kind_of(message),
        encoded(message, section, signed=signed),
        exchange_id=exchange_id,
        section_key=section_key_of(section.section_id),
    )


def size_table() -> str:
    """Return the table of bytes and frames for the paper's three roads, as it stands in docs/wire.md.

    Bytes count the frames' headers. The figure after the cross is the number of frames where it is not one.
    """
    lines = [
        f"| road | nodes | signed | {' | '.join(COLUMNS)} | exchange |",
        f"|---|---|---|{'---|' * len(COLUMNS)}---|",
    ]
    for name in ROADS:
        section = read_section(name)
        for signed in (False, True):
            frames = {
                kind: frames_of(message, section, signed=signed) for kind, message in exchange_messages(section).items()
            }
            cells = [_cell(frames[kind]) for kind in COLUMNS]
            whole = [frame for kind in EXCHANGE for frame in frames[kind]]
            lines.append(
                f"| {section.name}, {section.length_m:.0f} m | {len(section.nodes_m)} | {'yes' if signed else 'no'} "
                f"| {' | '.join(cells)} | {sum(map(len, whole))} bytes in {len(whole)} frames |"
            )
    return "\n".join(lines) + "\n"


def _cell(frames: tuple[bytes, ...]) -> str:
    size = sum(map(len, frames))
    return str(size) if len(frames) == 1 else f"{size} × {len(frames)}"


def cost_us(work: Callable[[], object]) -> float:
    """Return how long one call takes."""
    return 1e6 * cost_s(work, clock=time.perf_counter, rounds_count=7, budget_s=0.05)


def message_costs_us(section: RoadSection) -> dict[str, dict[str, float]]:
    """Return what the messages of a passage cost, each way, in microseconds."""
    exchange_id, section_key = exchange_id_of(bytes(range(16))), section_key_of(section.section_id)
    costs = {}
    for name, message in exchange_messages(section).items():
        kind, plain, signed = kind_of(message), encode_message(message), encoded(message, section, signed=True)
        believe = partial(
            message_of,
            Complete(kind, section_key, exchange_id, signed),
            expected=FROM_UNIT | FROM_VEHICLE,
            verifier=VERIFIER,
            required=True,
            now_unix_s=NOW_UNIX_S,
        )
        cut = partial(split_into_frames, kind, plain, exchange_id=exchange_id, section_key=section_key)
        costs[name] = {
            "encode": cost_us(partial(encode_message, message)),
            "and sign": cost_us(partial(encoded, message, section, signed=True)),
            "cut into frames": cost_us(cut),
            "parse a frame": cost_us(partial(parse_frame, cut()[0])),
            "decode": cost_us(partial(decode_message, kind, plain)),
            "and believe": cost_us(believe),
        }
    return costs


def main() -> None:
    """Print the tables and keep the figures."""
    parser = parser_of(__doc__, results_name="wire.json")
    parser.add_argument("--sizes", action="store_true", help="only the table of docs/wire.md")
    arguments = parser.parse_args()
    print(size_table())
    if arguments.sizes:
        return
    costs = message_costs_us(read_section("long-turn"))
    print(table_of([{"microseconds": name, **cost} for name, cost in costs.items()], number_format=".1f"))
    keep_figures(arguments.out, {"cost_us": costs})


if __name__ == "__main__":
    main()
