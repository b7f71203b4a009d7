"""What each target is asked first: one good input of every sort, and inputs that were findings once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from roadgrip.bundle import BundleManifest
from roadgrip.bundle_json import manifest_to_json
from roadgrip.certificates import RevocationList, certificate_to_pem, issue_revocations
from roadgrip.features import PAPER_TABLE
from roadgrip.frames import split_into_frames
from roadgrip.ledger import Action, entry_after, entry_to_json
from roadgrip.passage_export import head_to_json, passage_to_json
from roadgrip.release import Release, release_to_json
from roadgrip.section_file import section_to_json
from roadgrip.sign1 import sign1_in
from roadgrip.signing import Claims, Signer, sign
from roadgrip.wire import encode_message, kind_of
from rsu_app.adapters.updates.state_file import state_to_json
from rsu_app.domain.rollout import RolloutState, ShelvedBundle, Stage
from tests.bundles import CONFORMAL, ERROR_NAME, MODEL_NAME, make_model, make_ordinary, manifest_of
from tests.fuzz.targets import AUTHORITY, CAR, CERTIFICATE, KINDS, ROAD_FORMATS, TARGETS
from tests.roadgrip.test_passage_export import HEAD, PASSAGE
from tests.roadgrip.wire_samples import SAMPLES, winding_road
from vehicle_client.estimation.grip.memory import memory_to_json, new_memory
from vehicle_client.vehicle_profile import PAPER_VEHICLE, toml_of_profile

CORPUS_FOLDER = Path(__file__).resolve().parent / "corpus"
_ROADS = {
    "wkt": b"SRID=25833;LINESTRING Z (250000 6834000 300, 250010 6834001 301, 250020 6834004 301)",
    "geojson": b'{"type":"Feature","properties":{"speed_limit_kmh":80},"geometry":{"type":"LineString",'
    b'"coordinates":[[10.31,61.56],[10.3101,61.5601],[10.3103,61.5601]]}}',
    "csv": b"east_utm33,north_utm33,height,bank_ratio,speed_limit_kmh\n250000,6834000,300,0.01,80\n250010,6834001,,0,0",
    "nvdb": b'{"objekter":[{"geometri":{"wkt":"LINESTRING Z(250000 6834000 300, 250010 6834001 301)","srid":"5973"}}]}',
}
_SETTINGS = b"""sections = [{file = "s-turn", winter_speed_kph = 50}]
[http]
host = "127.0.0.1"
port = 8080
[udp]
enabled = true
[window]
length_s = 3600.0
[log]
level = "info"
"""
_SIGNALS = b"""dbc = "car.dbc"
[speed]
message = "Wheels"
signal = "Speed"
unit = "km/h"
"""
_SHELVED = ShelvedBundle("0123456789abcdef", "ab" * 32, 3, "cd" * 32, "passed")
_CLAIMS = Claims(1_700_000_100, 1_700_000_200, "bend", "0123456789abcdef")

_DEEP = b"[" * 2_000
_DIGITS = b"1" * 5_000
_FOUND: Mapping[str, tuple[bytes, ...]] = {
    # Under two tags a map is of a kind that cannot be changed, and the order of its keys was not looked at; and of a
    # negative key beside a larger one that is spelled longer two canonical orders say different things.
    "cbor": tuple(map(bytes.fromhex, ("d2d2a202000100", "d281a202000100", "fb3ff0000000000000", "a21818002000"))),
    # A private key with a byte too many made the library of the cryptography speak of an error of its own.
    "pem": (
        (
            b"\x00-----BEGIN PRIVATE KEY-----\nMC4CAQAwBQYDK2VxBCIEIAECAwQFBgcICQoLDA0ODxAREhMUFRYXGBkaGxwdHh8g\n"
            b"-----END PRIVATE KEY-----\n"
        ),
    ),
    # A parser of the standard library gives up with another error than for a misspelt text.
    "settings": (b"a=" + _DEEP, b"a=" + _DIGITS),
    "vehicle-profile": (b"a=" + _DEEP, b"a=" + _DIGITS),
    "signal-mapping": (b"a=" + _DEEP, b"a=" + _DIGITS),
    "export": (b"\x00" + _DEEP, b"\xff" + _DEEP),
    "ledger": (_DEEP, b'{"sequence_number": Infinity}', b'{"sequence_number": 1, "at_unix_s": ' + b"1" * 400 + b"}"),
    "release": (_DEEP,),
    "car-memory": (_DEEP,),
    "manifest": (_DEEP,),
    # Blanks were shared out between two repetitions in every possible way: half a minute for 20,000 of them.
    "road-import": (
        b"\x02LINESTRING" + b" " * 200_000 + b"x",
        b"\x02LINESTRING()" + b" " * 200_000 + b"x",
    ),
}


@cache
def seeds() -> Mapping[str, tuple[bytes, ...]]:
    """Return the inputs of each target by its name; the good ones first."""
    messages = [(kind_of(message), encode_message(message)) for message in SAMPLES.values()]
    frames = [
        frame
        for kind, payload in messages
        for frame in split_into_frames(kind, payload, exchange_id=bytes(8), section_key=bytes(4))
    ]
    good = {
        "frame": tuple(frames),
        "frames-body": (b"", b"".join(frames[:3])),
        "reassembler": (bytes(6), bytes([1, 0, 0, 7, 1, 0, 1, 1, 0, 7, 1, 0]), bytes(range(240))),
        "cbor": tuple(payload for _, payload in messages if len(payload) < 2_000),
        "wire": tuple(bytes([KINDS.index(kind)]) + payload for kind, payload in messages if len(payload) < 5_000),
        "signed": (
            b"\x00" + CERTIFICATE.encoded,
            b"\x00" + sign(b"payload", signer=Signer(CERTIFICATE, CAR), external_aad=b"x", claims=_CLAIMS),
            b"\x01" + sign1_in(CERTIFICATE.encoded).payload,
            b"\x02" + sign1_in(_revocations()).payload,
            b"\x03" + sign1_in(sign(b"", signer=Signer(CERTIFICATE, CAR), external_aad=b"x", claims=_CLAIMS)).protected,
        ),
        "pem": (
            b"\x00" + CAR.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
            b"\x01" + CAR.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo),
            b"\x02" + certificate_to_pem(CERTIFICATE),
        ),
        "settings": (b"", _SETTINGS),
        "section-file": (section_to_json(winding_road(8)).encode(),),
        "road-import": tuple(
            bytes([[each.value for each in ROAD_FORMATS].index(name)]) + text for name, text in _ROADS.items()
        ),
        "export": (b"\x00" + head_to_json(HEAD).encode(), b"\xff" + passage_to_json(PASSAGE).encode()),
        "ledger": (
            entry_to_json(
                entry_after(
                    None, at_unix_s=1.5e9, actor="unit", action=Action.LEDGER_BEGUN, subject="", reason="a new database"
                )
            ).encode(),
        ),
        "release": (
            release_to_json(
                Release(
                    ring="canary",
                    sequence_number=1,
                    bundle_id="0123456789abcdef",
                    files_sha256={"model.onnx": "ab" * 32},
                    released_unix_s=1_770_000_000,
                    released_by="anna",
                    reason="winter",
                    gate="passed",
                    ledger_hash="",
                )
            ).encode(),
        ),
        "rollout-state": (
            state_to_json(RolloutState()).encode(),
            state_to_json(
                RolloutState(candidate=_SHELVED, stage=Stage.SHADOW, newest_sequence_number=_SHELVED.sequence_number)
            ).encode(),
        ),
        "vehicle-profile": (toml_of_profile(PAPER_VEHICLE).encode(),),
        "car-memory": (memory_to_json(new_memory(handling_std_ratio=0.1)).encode(),),
        "signal-mapping": (_SIGNALS,),
        "manifest": (manifest_to_json(_manifest()).encode(),),
    }
    return {name: good[name] + _FOUND.get(name, ()) + found_before(name) for name in TARGETS}


def _revocations() -> bytes:
    return issue_revocations(RevocationList(1_700_000_000, 1_700_600_000, frozenset({bytes(8)})), authority=AUTHORITY)


def _manifest() -> BundleManifest:
    model = replace(make_model(table=PAPER_TABLE, conformal=CONFORMAL), ordinary=make_ordinary())
    return manifest_of([model], {MODEL_NAME: b"x", ERROR_NAME: b"y"}, name="linear")


def found_before(name: str) -> tuple[bytes, ...]:
    """Return what the corpus keeps for a target."""
    folder = CORPUS_FOLDER / name
    return tuple(path.read_bytes() for path in sorted(folder.iterdir())) if folder.is_dir() else ()
