"""Golden bytes of the wire format, version 1: how they are written down and read.

Each case is two files side by side: `NAME.hex`, its frames as a hex dump, and `NAME.json`, what they say. They were
written once by ``python -m tests.roadgrip.wire_golden``, which adds missing ones and never touches those that are
there: version 1 means these bytes.
"""

import dataclasses
import json
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from bench.certified import VERIFIER, claims_for, rightful_signer_of
from roadgrip.frames import Reassembler, exchange_id_of, parse_frame, section_key_of, split_into_frames
from roadgrip.records import Message
from roadgrip.section import RoadSection
from roadgrip.signing import NO_CLAIMS
from roadgrip.wire import Received, encode_message, kind_of, open_message
from tests.roadgrip.wire_samples import PASSAGE_ID, SAMPLES, SECTION

FOLDER = Path(__file__).resolve().parents[1] / "golden" / "wire" / "v1"
SIGNED = ("arrival", "map", "advisory", "summary", "receipt-accepted", "beacon")


def section_id_of(message: Message) -> str:
    """Return which section a message, or the exchange it belongs to, is about."""
    section = getattr(message, "section", None)
    return section.section_id if section is not None else getattr(message, "section_id", "winding-road")


def frames_of(message: Message, *, signed: bool) -> tuple[bytes, ...]:
    exchange_id = exchange_id_of(PASSAGE_ID)
    section_id = section_id_of(message)
    claims = claims_for(message, section_id=section_id, map_version=SECTION.version) if signed else NO_CLAIMS
    return split_into_frames(
        kind_of(message),
        encode_message(
            message,
            signer=rightful_signer_of(message) if signed else None,
            exchange_id=exchange_id,
            claims=claims,
        ),
        exchange_id=exchange_id,
        section_key=section_key_of(section_id),
    )


def received_in(frames: tuple[bytes, ...], *, signed: bool) -> Received:
    """Return the message that frames carry, its signature checked if it has one."""
    assembly = Reassembler(limit_count=1, limit_bytes=10**6, timeout_s=1.0)
    completes = [assembly.offer(parse_frame(frame), source="", now_s=0.0) for frame in frames]
    complete = completes[-1]
    assert complete is not None
    return open_message(
        complete.kind,
        complete.payload,
        verifier=VERIFIER if signed else None,
        required=signed,
        exchange_id=complete.exchange_id,
    )


def hex_dump(frames: tuple[bytes, ...]) -> str:
    """Return frames as people read bytes: offset, sixteen bytes, the same as text."""
    lines = []
    for number, frame in enumerate(frames, start=1):
        lines.append(f"# frame {number} of {len(frames)}, {len(frame)} bytes")
        for start in range(0, len(frame), 16):
            row = frame[start : start + 16]
            text = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in row)
            lines.append(f"{start:04x}  {row.hex(' '):47}  |{text}|")
    return "\n".join(lines) + "\n"


def frames_in(dump: str) -> tuple[bytes, ...]:
    """Return the frames of a hex dump."""
    frames: list[bytearray] = []
    for line in dump.splitlines():
        if line.startswith("#"):
            frames.append(bytearray())
        else:
            frames[-1] += bytes.fromhex(line[6:53])
    return tuple(map(bytes, frames))


def diagnosis(received: Received) -> str:
    """Return what a message says as JSON, and who has signed it."""
    content = {
        "kind": kind_of(received.message).name,
        "signed": received.signed is not None,
        "says": _plain(received.message),
    }
    if received.signed is not None:
        content |= {"claims": _plain(received.signed.claims), "certificate": _plain(received.signed.certificate)}
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, RoadSection):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return {"version": value.version, **{name: _plain(content) for name, content in fields.items()}}
    if dataclasses.is_dataclass(value):
        # What came later and is not used stands in no file that was there before.
        names = [field.name for field in dataclasses.fields(value) if getattr(value, field.name) != b""]
        return {"is": type(value).__name__, **{name: _plain(getattr(value, name)) for name in names}}
    if isinstance(value, np.ndarray):
        return [" ".join(f"{v:.10g}" for v in np.atleast_1d(row)) for row in value]
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, tuple):
        return [_plain(v) for v in value]
    return value


def cases() -> dict[str, tuple[Message, bool]]:
    """Return every case by name: the message, and whether it is signed."""
    plain = {name: (message, False) for name, message in SAMPLES.items()}
    return plain | {f"{name}-signed": (SAMPLES[name], True) for name in SIGNED}


def write_missing() -> None:
    """Write the files of cases that have none yet."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, (message, signed) in cases().items():
        frames = frames_of(message, signed=signed)
        says = diagnosis(received_in(frames, signed=signed))
        for suffix, text in ((".hex", hex_dump(frames)), (".json", says)):
            path = FOLDER / f"{name}{suffix}"
            if not path.exists():
                path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write_missing()
