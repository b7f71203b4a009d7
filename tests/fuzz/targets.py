"""Everything of ours that reads what others wrote, each as one question to bytes: is the promise kept?

A target returns in silence or raises. What it raises is a finding: an error that is not documented, a budget that is
exceeded, or something that was read and does not come out again as it was. The same targets are asked by hypothesis in
the test suite and by a coverage-guided fuzzer in `make fuzz`.
"""

from __future__ import annotations

import os
import struct
import tempfile
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import cbor2
import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from roadgrip.bundle_json import manifest_from_json, manifest_to_json
from roadgrip.cbor import TAG_SIGN1, strict_dumps, strict_loads
from roadgrip.certificates import (
    Role,
    certificate_in_pem,
    certificate_to_pem,
    check_certificate,
    issue_certificate,
    issue_revocations,
    read_certificate,
    read_revocations,
)
from roadgrip.errors import BundleError, ConfigurationError, FeatureTableError, SectionError, WireError
from roadgrip.frames import Frame, Reassembler, iter_frames, join_frames, parse_frame, split_into_frames
from roadgrip.ledger import LedgerError, entry_from_json, entry_to_json
from roadgrip.passage_export import (
    ExportError,
    head_from_json,
    head_to_json,
    passage_from_json,
    passage_to_json,
)
from roadgrip.protocol import FRAGMENT_BYTES, FRAMES_LIMIT_COUNT, HEADER_BYTES, PROTOCOL_VERSION, Kind
from roadgrip.release import ReleaseError, release_from_json, release_to_json
from roadgrip.section_file import section_from_json, section_to_json
from roadgrip.sign1 import external_aad_for, key_id_of, private_key_in, public_key_in, sealed, sign1_in
from roadgrip.signing import Signer, Verifier, is_signed, sign
from roadgrip.wire import decode_message, encode_message
from rsu_app.adapters.updates.state_file import StateFileError, state_from_json, state_to_json
from rsu_app.road_import.reading import RoadFormat, survey_of_bytes
from rsu_app.settings import Settings, load_settings
from vehicle_client.estimation.grip.memory import memory_of_json, memory_to_json
from vehicle_client.recording.signal_mapping import signal_mapping_of_toml
from vehicle_client.vehicle_profile import profile_of_toml, toml_of_profile

KINDS = tuple(Kind)
ROAD_FORMATS = tuple(RoadFormat)
REFERENCES = (None, "local", "EPSG:25833", "EPSG:4326")
# They open nothing.
AUTHORITY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
CAR = Ed25519PrivateKey.from_private_bytes(bytes(range(1, 33)))
AUTHORITIES = {key_id_of(AUTHORITY.public_key()): AUTHORITY.public_key()}
CERTIFICATE = issue_certificate(
    CAR.public_key().public_bytes_raw(),
    authority=AUTHORITY,
    certificate_id=bytes(8),
    role=Role.VEHICLE,
    valid_from_unix_s=1_700_000_000,
    valid_until_unix_s=1_700_600_000,
)
REASSEMBLER_LIMIT_COUNT = 4
REASSEMBLER_LIMIT_BYTES = 12_000


@dataclass(frozen=True, slots=True)
class Target:
    """One parser.

    Attributes:
        check: Returns if the promise is kept for these bytes.
        limit_bytes: Longer inputs only take time.
    """

    check: Callable[[bytes], None]
    limit_bytes: int


def check_frame(data: bytes) -> None:
    """A datagram is refused, or is a frame whose header can be made again from what was read."""
    try:
        frame = parse_frame(data)
    except WireError:
        return
    assert _frame_bytes(frame) == data
    if frame.pieces_count == 1:
        assert split_into_frames(
            frame.kind, frame.fragment, exchange_id=frame.exchange_id, section_key=frame.section_key
        ) == (data,)


def check_frames_body(data: bytes) -> None:
    """An HTTP body is refused, or is a row of frames that joined give the body again."""
    try:
        frames = list(iter_frames(data))
    except WireError:
        return
    assert join_frames(frames) == data


def check_reassembler(data: bytes) -> None:
    """Whatever pieces come in whatever order: memory stays within its budget, and what is whole fits its checksum.

    Each six bytes are one frame: chance alone would never find a valid checksum.
    """
    reassembler = Reassembler(limit_count=REASSEMBLER_LIMIT_COUNT, limit_bytes=REASSEMBLER_LIMIT_BYTES, timeout_s=10.0)
    now_s = 0.0
    for start in range(0, len(data) - 5, 6):
        shape, index, source, message, step, filling = data[start : start + 6]
        now_s += step / 16.0
        count = 1 + shape % FRAMES_LIMIT_COUNT[Kind.MAP]
        index %= count
        whole = b"".join(_piece(message, place, count) for place in range(count))
        fragment = _piece(message if filling < 200 else filling, index, count)
        crc = zlib.crc32(whole) if shape < 240 else filling
        complete = reassembler.offer(
            Frame(Kind.MAP, b"key.", bytes([message % 4]) * 8, index, count, crc, 0, fragment),
            source=source % 4,
            now_s=now_s,
        )
        assert reassembler.held_count <= REASSEMBLER_LIMIT_COUNT
        assert 0 <= reassembler.held_bytes <= REASSEMBLER_LIMIT_BYTES
        if complete is not None and count > 1:
            assert zlib.crc32(complete.payload) == crc
    reassembler.expire(now_s=now_s + 11.0)
    assert (reassembler.held_count, reassembler.held_bytes) == (0, 0)


def check_cbor(data: bytes) -> None:
    """Bytes are refused, or are the only spelling of their value."""
    try:
        value = strict_loads(data)
    except WireError:
        return
    assert strict_dumps(value) == data


def check_wire(data: bytes) -> None:
    """A message of any kind is refused, or encodes to the same bytes again. The first byte says which kind."""
    if not data:
        return
    kind, payload = KINDS[data[0] % len(KINDS)], data[1:]
    try:
        message = decode_message(kind, payload)
    except WireError:
        return
    # Read without asking who has signed it, a signed message comes out unsigned.
    assert encode_message(message) == payload or is_signed(payload)


def check_signed(data: bytes) -> None:
    """A seal, certificate, list or header is refused, or has no second spelling. The first byte says which.

    What an authority or a car would have signed is sealed here with keys for tests: chance never finds a signature.
    """
    if not data:
        return
    what, content = data[0] % 4, data[1:]
    try:
        if what == 0:
            parts = sign1_in(content)
            header = {13: cbor2.loads(parts.certificate)} if parts.certificate else {}
            fields = [parts.protected, header, parts.payload, parts.signature]
            assert cbor2.dumps(cbor2.CBORTag(TAG_SIGN1, fields), canonical=True) == content
        elif what == 1:
            said = read_certificate(_sealed_by_authority(content, "CERTIFICATE"))
            check_certificate(said, AUTHORITIES)
            assert certificate_in_pem(certificate_to_pem(said)) == said
        elif what == 2:
            said_back = read_revocations(_sealed_by_authority(content, "REVOCATIONS"), AUTHORITIES)
            assert read_revocations(issue_revocations(said_back, authority=AUTHORITY), AUTHORITIES) == said_back
        else:
            message = sealed(
                b"payload", private_key=CAR, protected=content, external_aad=b"x", certificate=CERTIFICATE.encoded
            )
            signed = Verifier(AUTHORITIES).unsealed(message, external_aad=b"x")[1]
            signer = Signer(CERTIFICATE, CAR)
            assert sign(b"payload", signer=signer, external_aad=b"x", claims=signed.claims) == message
    except WireError:
        return


def check_pem(data: bytes) -> None:
    """A PEM file is refused with words, or holds one key or certificate. The first byte says which is looked for."""
    readers: tuple[Callable[[bytes], object], ...] = (private_key_in, public_key_in, certificate_in_pem)
    with suppress(ConfigurationError):
        readers[(data[0] if data else 0) % 3](data[1:])


def check_settings(data: bytes) -> None:
    """A configuration file gives settings, or an error that says what is wrong with it."""
    file = _scratch_file()
    file.write_bytes(data)
    try:
        found = load_settings(file)
    except ConfigurationError:
        return
    assert isinstance(found, Settings)


def check_section_file(data: bytes) -> None:
    """A section file is refused, or is written as a text that reads back as the same section."""
    text = data.decode("utf-8", errors="replace")
    try:
        section = section_from_json(text)
    except SectionError:
        return
    written = section_to_json(section)
    again = section_from_json(written)
    assert again.version == section.version
    assert section_to_json(again) == written


def check_road_import(data: bytes) -> None:
    """A surveyed road is refused, or is a line of finite points. The first byte says as what it is read."""
    if not data:
        return
    road_format = ROAD_FORMATS[data[0] % len(ROAD_FORMATS)]
    crs = REFERENCES[data[0] // len(ROAD_FORMATS) % len(REFERENCES)]
    try:
        line = survey_of_bytes(data[1:], road_format=road_format, crs=crs)
    except SectionError:
        return
    assert len(line.points_m) >= 2
    assert np.isfinite(line.points_m).all()


def check_export(data: bytes) -> None:
    """A line of an export is refused, or is written as a line that reads back the same; head or passage by chance."""
    line = data[1:].decode("utf-8", errors="replace")
    if data[:1] < b"\x80":
        _check_line(line, head_from_json, head_to_json, ExportError)
    else:
        _check_line(line, passage_from_json, passage_to_json, ExportError)


def check_ledger(data: bytes) -> None:
    """A line of a ledger is refused, or is written as a line that reads back the same."""
    _check_line(data.decode("utf-8", errors="replace"), entry_from_json, entry_to_json, LedgerError)


def check_release(data: bytes) -> None:
    """A release is refused, or is written as a text that reads back the same."""
    _check_line(data.decode("utf-8", errors="replace"), release_from_json, release_to_json, ReleaseError)


def check_rollout_state(data: bytes) -> None:
    """The state of a shelf is refused, or is written as a text that reads back the same."""
    _check_line(data.decode("utf-8", errors="replace"), state_from_json, state_to_json, StateFileError)


def check_vehicle_profile(data: bytes) -> None:
    """A vehicle's profile is refused, or is written as a text that reads back the same."""
    text = data.decode("utf-8", errors="replace")
    _check_line(text, partial(profile_of_toml, place="car.toml"), toml_of_profile, ConfigurationError)


def check_car_memory(data: bytes) -> None:
    """What a car has learned is refused, or is written as a text that reads back the same."""
    _check_line(data.decode("utf-8", errors="replace"), memory_of_json, memory_to_json, ConfigurationError)


def check_signal_mapping(data: bytes) -> None:
    """A mapping of signals is refused with words, or taken."""
    with suppress(ConfigurationError):
        signal_mapping_of_toml(data.decode("utf-8", errors="replace"), place="signals.toml")


def check_manifest(data: bytes) -> None:
    """A bundle's manifest is refused, or is written as a text that reads back as an equal one."""
    try:
        manifest = manifest_from_json(data.decode("utf-8", errors="replace"))
    except (BundleError, FeatureTableError):
        return
    try:
        written = manifest_to_json(manifest)
    except BundleError:  # a figure of more than 32 bits, which the packed matrices do not hold
        return
    assert manifest_to_json(manifest_from_json(written)) == written


TARGETS: Mapping[str, Target] = {
    "frame": Target(check_frame, 1_500),
    "frames-body": Target(check_frames_body, 32_000),
    "reassembler": Target(check_reassembler, 600),
    "cbor": Target(check_cbor, 9_000),
    "wire": Target(check_wire, 9_000),
    "signed": Target(check_signed, 2_000),
    "pem": Target(check_pem, 2_000),
    "settings": Target(check_settings, 4_000),
    "section-file": Target(check_section_file, 8_000),
    "road-import": Target(check_road_import, 8_000),
    "export": Target(check_export, 8_000),
    "ledger": Target(check_ledger, 4_000),
    "release": Target(check_release, 4_000),
    "rollout-state": Target(check_rollout_state, 4_000),
    "vehicle-profile": Target(check_vehicle_profile, 4_000),
    "car-memory": Target(check_car_memory, 8_000),
    "signal-mapping": Target(check_signal_mapping, 4_000),
    "manifest": Target(check_manifest, 40_000),
}


def _sealed_by_authority(payload: bytes, purpose: str) -> bytes:
    header = strict_dumps({1: -8, 4: key_id_of(AUTHORITY.public_key())})
    return sealed(payload, private_key=AUTHORITY, protected=header, external_aad=external_aad_for(purpose))


def _check_line(line: str, read: Callable[[str], Any], write: Callable[[Any], str], refusal: type[Exception]) -> None:
    try:
        found = read(line)
    except refusal:
        return
    written = write(found)
    assert write(read(written)) == written


def _piece(message: int, index: int, count: int) -> bytes:
    size = FRAGMENT_BYTES if index + 1 < count else 1 + message
    return bytes([message, index]) * (size // 2) + b"." * (size % 2)


def _frame_bytes(frame: Frame) -> bytes:
    head = struct.pack(
        ">2sBB4s8sBBHI",
        b"RG",
        PROTOCOL_VERSION,
        frame.kind,
        frame.section_key,
        frame.exchange_id,
        frame.piece_index,
        frame.pieces_count,
        len(frame.fragment),
        frame.message_crc,
    )
    datagram = head + struct.pack(">I", frame.crc) + frame.fragment
    assert len(datagram) == HEADER_BYTES + len(frame.fragment)
    return datagram


@cache
def _scratch_file() -> Path:
    folder = tempfile.TemporaryDirectory(prefix=f"roadgrip-fuzz-{os.getpid()}-")
    _FOLDERS.append(folder)
    return Path(folder.name) / "rsu.toml"


_FOLDERS: list[tempfile.TemporaryDirectory[str]] = []
"""Removed when the process ends."""
