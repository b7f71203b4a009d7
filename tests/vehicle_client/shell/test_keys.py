from __future__ import annotations

from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from roadgrip.errors import ConfigurationError, WireError
from roadgrip.frames import exchange_id_of, section_key_of, split_into_frames
from roadgrip.records import Accepted, Arrival, Reason, Receipt
from roadgrip.signing import signer_from_pem, verifier_from_pems
from roadgrip.wire import decode_message, encode_message, kind_of
from tests.vehicle_client.shell.air import PASSAGE_ID
from vehicle_client.shell.keys import Keys, read_keys


def a_key(folder: Path, name: str) -> tuple[Path, Path]:
    """Write a pair; return the private file and the public one."""
    key = Ed25519PrivateKey.generate()
    private, public = folder / f"{name}.key.pem", folder / f"{name}.pem"
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    public.write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    return private, public


def a_receipt_frame(private: Path | None) -> bytes:
    receipt = Receipt(PASSAGE_ID, Accepted())
    signer = None if private is None else signer_from_pem(private.read_bytes())
    (frame,) = split_into_frames(
        kind_of(receipt),
        encode_message(receipt, signer=signer),
        exchange_id=exchange_id_of(PASSAGE_ID),
        section_key=section_key_of("bend"),
    )
    return frame


def test_without_keys_nothing_is_signed_and_everybody_is_believed():
    assert read_keys(None, []) == Keys()


def test_what_a_vehicle_sends_is_signed_with_its_key(tmp_path: Path):
    private, public = a_key(tmp_path, "vehicle")
    (frame,) = read_keys(private, []).codecs_for("bend")(PASSAGE_ID).frames_of(Arrival(PASSAGE_ID, "bend"))
    verifier = verifier_from_pems([public.read_bytes()], required=True)
    arrival = Arrival(PASSAGE_ID, "bend")
    assert decode_message(kind_of(arrival), frame[28:], verifier=verifier) == arrival


def test_a_vehicle_with_trusted_keys_believes_signed_answers_only(tmp_path: Path):
    private, public = a_key(tmp_path, "unit")
    stranger, _ = a_key(tmp_path, "stranger")
    codec = read_keys(None, [public]).codecs_for("bend")(PASSAGE_ID)
    assert codec.message_of(a_receipt_frame(private), now_s=0.0) == Receipt(PASSAGE_ID, Accepted())
    for frame, reason in ((a_receipt_frame(None), Reason.UNSIGNED), (a_receipt_frame(stranger), Reason.UNKNOWN_KEY)):
        with pytest.raises(WireError) as refusal:
            codec.message_of(frame, now_s=0.0)
        assert refusal.value.reason is reason


def test_a_file_that_is_no_key_is_named(tmp_path: Path):
    nonsense = tmp_path / "nonsense.pem"
    nonsense.write_text("not a key", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"nonsense\.pem"):
        read_keys(nonsense, [])
    with pytest.raises(ConfigurationError, match=r"nonsense\.pem"):
        read_keys(None, [nonsense])
