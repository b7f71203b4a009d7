"""The command of an authority: what it writes is what units and vehicles go by."""

from __future__ import annotations

import json
import stat
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat
from typer.testing import CliRunner

from roadgrip.certificates import Role, check_certificate
from roadgrip.errors import ConfigurationError, RoadgripError, WireError
from roadgrip.reasons import Reason
from roadgrip.signing import Signer, Verifier
from roadgrip.trust import credential_in, trust_in
from roadgrip.wire import Kind, encode_message, open_message
from tests.roadgrip.wire_samples import PASSAGE
from training.authority.cli import app
from training.authority.folder import DAY_S
from vehicle_client.shell.keys import KeyPlaces


class Operator:
    """Gives commands to an authority in a folder of his own."""

    def __init__(self, folder: Path):
        self.folder = folder

    def result(self, *words: object):
        return CliRunner().invoke(app, [str(word) for word in words], env={"ROADGRIP_AUTHORITY": str(self.folder)})

    def says(self, *words: object) -> Any:
        result = self.result(*words, "--json")
        if isinstance(result.exception, RoadgripError):
            raise result.exception
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    def verifier(self, *, revocations: bool = False) -> Verifier:
        places = KeyPlaces((), (self.folder / "public",), self.folder / "revoked.cose" if revocations else None)
        verifier = trust_in(places.read()).verifier
        assert verifier is not None
        return verifier

    def pseudonyms(self, name: str) -> list[Signer]:
        folder = self.folder / "issued" / "pseudonyms" / name
        return [credential_in(path.read_bytes()) for path in sorted(folder.iterdir())]


@pytest.fixture
def operator(tmp_path: Path) -> Operator:
    made = Operator(tmp_path / "authority")
    made.says("init")
    return made


def modes_of(folder: Path) -> set[int]:
    return {stat.S_IMODE(path.stat().st_mode) for path in folder.rglob("*.pem")}


def test_a_unit_is_certified_for_its_sections_for_a_year(operator):
    issued = operator.says("issue-unit", "rv3-km12", "--section", "s-turn", "--section", "long-turn")
    signer = credential_in(Path(issued["path"]).read_bytes())
    certificate = signer.certificate
    check_certificate(certificate, operator.verifier().authorities)
    assert (certificate.role, certificate.section_ids) == (Role.UNIT, ("long-turn", "s-turn"))
    assert certificate.in_date(time.time())
    assert certificate.valid_until_unix_s - certificate.valid_from_unix_s == 365 * DAY_S
    assert certificate.certificate_id.hex() == issued["certificate_id"]


def test_private_keys_are_their_owners_alone(operator):
    operator.says("issue-unit", "rv3-km12")
    operator.says("issue-pseudonyms", "batch-1", "--count", 3)
    assert modes_of(operator.folder / "keys") == modes_of(operator.folder / "issued") == {0o600}


def test_a_batch_of_pseudonyms_names_nobody_and_tells_nobody_apart(operator):
    operator.says("issue-pseudonyms", "batch-1")
    operator.says("issue-pseudonyms", "batch-2")
    all_of_them = [*operator.pseudonyms("batch-1"), *operator.pseudonyms("batch-2")]
    certificates = [signer.certificate for signer in all_of_them]
    assert len({c.certificate_id for c in certificates}) == len({c.public_key for c in certificates}) == 40
    assert {c.role for c in certificates} == {Role.VEHICLE}
    ((start, end),) = {(c.valid_from_unix_s, c.valid_until_unix_s) for c in certificates}
    assert (start % DAY_S, end - start) == (0, 7 * DAY_S)
    assert all(b"batch" not in c.encoded for c in certificates)


def test_a_batch_may_begin_later(operator):
    operator.says("issue-pseudonyms", "batch-1", "--count", 1, "--starts-in-days", 7)
    (signer,) = operator.pseudonyms("batch-1")
    assert not signer.certificate.in_date(time.time())
    assert signer.certificate.in_date(time.time() + 8 * DAY_S)


def test_a_unit_may_keep_its_private_key_to_itself(operator, tmp_path):
    key = Ed25519PrivateKey.generate()
    (tmp_path / "unit.pub").write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    issued = operator.says("issue-unit", "rv3-km12", "--public-key", tmp_path / "unit.pub")
    certificate_pem = Path(issued["path"]).read_bytes()
    assert b"PRIVATE" not in certificate_pem
    private_pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    assert credential_in(private_pem + certificate_pem).certificate.section_ids == ()


def test_a_revoked_batch_is_believed_until_the_list_was_published(operator):
    operator.says("issue-pseudonyms", "batch-1", "--count", 2)
    operator.says("issue-pseudonyms", "batch-2", "--count", 1)
    assert len(operator.says("revoke", "batch-1", "--why", "car was stolen")["revoked"]) == 2
    assert operator.says("publish")["revoked_count"] == 2
    stolen, honest = operator.pseudonyms("batch-1")[0], operator.pseudonyms("batch-2")[0]
    verifier = operator.verifier(revocations=True)
    open_message(Kind.SUMMARY, encode_message(PASSAGE, signer=honest), verifier=verifier, required=True)
    payload = encode_message(PASSAGE, signer=stolen)
    open_message(Kind.SUMMARY, payload, verifier=operator.verifier(), required=True)
    with pytest.raises(WireError) as caught:
        open_message(Kind.SUMMARY, payload, verifier=verifier, required=True)
    assert caught.value.reason is Reason.CERTIFICATE_REVOKED


def test_revoking_twice_changes_nothing(operator):
    certificate_id = operator.says("issue-unit", "rv3-km12")["certificate_id"]
    assert operator.says("revoke", certificate_id[:6])["revoked"] == [certificate_id]
    assert operator.says("revoke", "rv3-km12")["revoked"] == []
    (entry,) = operator.says("list")
    assert (entry["certificate_id"], entry["state"]) == (certificate_id, "revoked")


def test_a_rotation_leaves_what_was_issued_before_valid(operator):
    before = operator.says("issue-unit", "old")
    operator.says("rotate")
    after = operator.says("issue-unit", "new")
    assert before["authority_id"] != after["authority_id"]
    authorities = operator.verifier().authorities
    assert len(authorities) == 2
    for issued in (before, after):
        check_certificate(credential_in(Path(issued["path"]).read_bytes()).certificate, authorities)
    (operator.folder / "public" / "authority-1.pem").unlink()
    with pytest.raises(WireError) as caught:
        check_certificate(credential_in(Path(before["path"]).read_bytes()).certificate, operator.verifier().authorities)
    assert caught.value.reason is Reason.UNKNOWN_KEY


def test_what_stands_is_shown(operator):
    operator.says("issue-unit", "rv3-km12")
    operator.says("rotate")
    operator.says("issue-pseudonyms", "batch-1", "--count", 3)
    operator.says("publish")
    standing = operator.says("show")
    assert (standing["units in date"], standing["pseudonyms in date"], standing["revoked"]) == (1, 3, 0)
    assert standing["list overdue"] is False
    first, second = (value for key, value in standing.items() if key.startswith("authority "))
    assert "1 certificates" in first
    assert "3 certificates" in second


def test_a_file_is_shown(operator):
    issued = operator.says("issue-unit", "rv3-km12", "--section", "s-turn")
    shown = operator.says("show", issued["path"])
    assert shown["certificate_id"] == issued["certificate_id"]
    assert shown["section_ids"] == ["s-turn"]


def test_private_keys_of_an_authority_may_be_encrypted(tmp_path):
    (tmp_path / "password").write_text("correct horse\n", encoding="utf-8")
    operator = Operator(tmp_path / "authority")
    operator.says("init", "--password-file", tmp_path / "password")
    assert b"ENCRYPTED" in (tmp_path / "authority" / "keys" / "authority-1.pem").read_bytes()
    operator.says("issue-unit", "rv3-km12", "--password-file", tmp_path / "password")
    with pytest.raises(ConfigurationError, match=r"authority-1\.pem"):
        operator.says("issue-unit", "another")


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("init",), "is not empty"),
        (("issue-unit", "Kilometre 12"), "is no name"),
        (("issue-unit", "../elsewhere"), "is no name"),
        (("issue-unit", "unit", "--section", "Long Turn"), "section id"),
        (("issue-unit", "unit", *[word for n in range(9) for word in ("--section", f"{n}" * 48)]), "scope"),
        (("issue-unit", "unit", "--public-key", "no-such.pub"), "no-such.pub"),
        (("revoke", "nobody"), "no certificate has the id or name"),
        (("show", "no-such.pem"), "no-such.pem"),
    ],
)
def test_what_cannot_be_changes_nothing(operator, words, complaint):
    result = operator.result(*words)
    assert result.exit_code != 0
    assert complaint in str(result.exception)
    assert operator.says("list", "--all") == []


def test_a_file_is_never_written_over(operator):
    operator.says("issue-unit", "rv3-km12")
    with pytest.raises(ConfigurationError, match="is there already"):
        operator.says("issue-unit", "rv3-km12")
    operator.says("issue-pseudonyms", "batch-1", "--count", 1)
    with pytest.raises(ConfigurationError, match="is there already"):
        operator.says("issue-pseudonyms", "batch-1", "--count", 1)


def test_without_an_authority_one_line_says_how_to_begin(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "training.authority", "list", "--folder", str(tmp_path / "none")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith("roadgrip-authority: ")
    assert "roadgrip-authority init" in line


def test_a_damaged_register_is_named_by_its_line(operator):
    operator.says("issue-unit", "rv3-km12")
    register = operator.folder / "register.jsonl"
    register.write_text(register.read_text(encoding="utf-8") + "{half a li", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="line 2"):
        operator.says("list")


def test_the_authority_starts_without_the_laboratory():
    loaded = "import sys, training.authority.cli; print('\\n'.join(sys.modules))"
    modules = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True).stdout.split()
    heavy = {"mlflow", "numba", "xgboost", "scipy", "pandas", "securesystemslib", "vehicle_client.simulator"}
    assert not heavy & set(modules)
