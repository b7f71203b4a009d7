"""Whose pseudonyms a vehicle signs with, whom it believes, and that both change without a restart."""

from __future__ import annotations

from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from bench.certified import AUTHORITY_KEY, NOW_UNIX_S, UNIT, VEHICLE, VERIFIER, YEAR_S, signer_of
from roadgrip.certificates import RevocationList, Role, issue_revocations
from roadgrip.errors import ConfigurationError
from roadgrip.records import Arrival
from roadgrip.signing import Signed
from roadgrip.trust import credential_to_pem
from roadgrip.wire import Kind, open_message
from tests.vehicle_client.shell.air import PASSAGE_ID
from vehicle_client.shell.keys import Keys, no_clock, read_keys

NAMES = [f"pseudonym-{number:02}" for number in range(20)]


def write_credentials(folder: Path, *, valid_until_unix_s: int = NOW_UNIX_S + YEAR_S) -> None:
    folder.mkdir(exist_ok=True)
    for number, name in enumerate(NAMES):
        pseudonym = signer_of(
            Role.VEHICLE,
            certificate_id=number.to_bytes(8, "big"),
            private_key=Ed25519PrivateKey.from_private_bytes(bytes([number]) * 32),
            valid_until_unix_s=valid_until_unix_s,
        )
        (folder / f"{name}.pem").write_bytes(credential_to_pem(pseudonym))


def write_authority(path: Path) -> Path:
    path.write_bytes(AUTHORITY_KEY.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    return path


def signed_by(keys: Keys, passage_id: bytes = PASSAGE_ID) -> Signed | None:
    (frame,) = keys.codecs_for("bend")(passage_id).frames_of(Arrival(passage_id, "bend"))
    return open_message(Kind.ARRIVAL, frame[28:], verifier=VERIFIER).signed


def certificate_id_by(keys: Keys, passage_id: bytes) -> bytes:
    signed = signed_by(keys, passage_id)
    assert signed is not None
    return signed.certificate.certificate_id


def test_without_files_nothing_is_signed_and_everybody_is_believed():
    assert signed_by(Keys()) is None
    assert Keys().verifier is None


def test_what_a_vehicle_sends_is_signed_and_says_when(tmp_path: Path):
    (tmp_path / "car.pem").write_bytes(credential_to_pem(VEHICLE))
    keys = read_keys([tmp_path / "car.pem"], unix_s=lambda: NOW_UNIX_S + 0.9)
    signed = signed_by(keys)
    assert signed is not None
    assert signed.certificate == VEHICLE.certificate
    assert signed.claims.issued_unix_s == NOW_UNIX_S


def test_a_car_without_a_clock_does_not_say_when(tmp_path: Path):
    (tmp_path / "car.pem").write_bytes(credential_to_pem(VEHICLE))
    signed = signed_by(read_keys([tmp_path / "car.pem"], unix_s=no_clock))
    assert signed is not None
    assert signed.claims.issued_unix_s is None


def test_passages_show_different_pseudonyms_and_one_passage_always_the_same(tmp_path: Path):
    write_credentials(tmp_path / "pseudonyms")
    keys = read_keys([tmp_path / "pseudonyms"], unix_s=lambda: NOW_UNIX_S)
    passages = [bytes(8) + number.to_bytes(8, "big") for number in range(40)]
    shown = {certificate_id_by(keys, passage_id) for passage_id in passages}
    assert len(shown) == 20
    assert {certificate_id_by(keys, PASSAGE_ID) for _ in range(5)} == {certificate_id_by(keys, PASSAGE_ID)}


def test_a_pseudonym_that_has_ended_is_not_shown_any_more(tmp_path: Path):
    write_credentials(tmp_path / "pseudonyms", valid_until_unix_s=NOW_UNIX_S - 1)
    keys = read_keys([tmp_path / "pseudonyms"], unix_s=lambda: NOW_UNIX_S)
    assert keys.pseudonyms_count == 0
    assert signed_by(keys) is None


def test_new_pseudonyms_are_used_without_a_restart(tmp_path: Path):
    write_credentials(tmp_path / "pseudonyms", valid_until_unix_s=NOW_UNIX_S - 1)
    keys = read_keys([tmp_path / "pseudonyms"], unix_s=lambda: NOW_UNIX_S)
    assert not keys.renew()
    write_credentials(tmp_path / "pseudonyms")
    assert keys.renew()
    assert signed_by(keys) is not None


def test_a_file_that_is_damaged_meanwhile_changes_nothing(tmp_path: Path):
    (tmp_path / "car.pem").write_bytes(credential_to_pem(VEHICLE))
    keys = read_keys([tmp_path / "car.pem"], unix_s=lambda: NOW_UNIX_S)
    (tmp_path / "car.pem").write_text("half of it", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"car\.pem"):
        keys.renew()
    assert signed_by(keys) is not None


def test_a_newer_list_of_revoked_certificates_is_taken_and_an_older_one_is_not(tmp_path: Path):
    authority = write_authority(tmp_path / "authority.pem")

    def publish(issued_unix_s: int, *ids: bytes) -> None:
        revoked = RevocationList(issued_unix_s, 2**40, frozenset(ids))
        (tmp_path / "revoked.cose").write_bytes(issue_revocations(revoked, authority=AUTHORITY_KEY))

    publish(10, b"stolen!!")
    keys = read_keys((), [authority], tmp_path / "revoked.cose")
    for issued_unix_s, expected in ((9, {b"stolen!!"}), (11, set())):
        publish(issued_unix_s)
        keys.renew()
        assert keys.verifier is not None
        assert keys.verifier.revocations is not None
        assert keys.verifier.revocations.certificate_ids == expected


@pytest.mark.parametrize("content", [b"not a key", credential_to_pem(UNIT)[:300]])
def test_a_file_of_something_else_is_named(tmp_path: Path, content: bytes):
    nonsense = tmp_path / "nonsense.pem"
    nonsense.write_bytes(content)
    with pytest.raises(ConfigurationError, match=r"nonsense\.pem"):
        read_keys([nonsense])
    with pytest.raises(ConfigurationError, match=r"nonsense\.pem"):
        read_keys((), [nonsense])


def test_a_car_does_not_take_the_credential_of_a_unit_for_its_own(tmp_path: Path):
    (tmp_path / "unit.pem").write_bytes(credential_to_pem(UNIT))
    with pytest.raises(ConfigurationError, match="that of a unit"):
        read_keys([tmp_path / "unit.pem"])


def test_an_empty_folder_is_named(tmp_path: Path):
    with pytest.raises(ConfigurationError, match="no file"):
        read_keys((), [tmp_path])
