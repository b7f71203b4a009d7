"""A unit that its network can reach: HTTPS, a token for operators, and both replaced while it runs."""

import ssl
import time

import httpx
import pytest

from rsu_app.operator_tokens import TokenScope, new_token
from tests.rsu_app.adapters.http.certificates import Identity, make_identity
from tests.system.daemons import Daemon

PATIENT_S = 30.0


def client(daemon: Daemon, trusted: Identity) -> httpx.Client:
    context = ssl.create_default_context(cadata=trusted.certificate_pem.decode())
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    return httpx.Client(base_url=daemon.url, verify=context, timeout=PATIENT_S)


@pytest.mark.system
@pytest.mark.timeout(180)
def test_a_unit_shows_its_certificate_and_asks_operators_for_a_token(tmp_path, monkeypatch):
    before, after = (make_identity("unit", days=days, authority=True) for days in (10.0, 90.0))
    certificate, key = before.write(tmp_path, "unit")
    token, line = new_token([TokenScope.METRICS, TokenScope.HEALTH])
    tokens = tmp_path / "tokens"
    tokens.write_text(line, encoding="utf-8")
    tokens.chmod(0o600)
    monkeypatch.setenv("ROADGRIP_HTTP__TLS_CERTIFICATE_FILE", str(certificate))
    monkeypatch.setenv("ROADGRIP_HTTP__TLS_KEY_FILE", str(key))
    monkeypatch.setenv("ROADGRIP_OPERATORS__TOKENS_FILE", str(tokens))
    operator = {"Authorization": f"Bearer {token}"}
    with Daemon(tmp_path) as daemon:
        assert daemon.url.startswith("https://")
        with client(daemon, before) as asker:
            assert asker.get("/v1/sections").status_code == 200
            assert asker.get("/metrics").json()["reason"] == "no_token"
            shown = asker.get("/metrics", headers=operator).text
            assert "roadgrip_http_certificate_days 9." in shown
            assert 'roadgrip_http_refusals_total{reason="no_token"} 1.0' in shown
            conditions = asker.get("/health/ready", headers=operator).json()["conditions"]
            [noted] = [condition for condition in conditions if condition["name"] == "certificate"]
            assert (noted["ok"], noted["required"]) == (False, False)
        after.write(tmp_path, "unit")
        give_up_s = time.monotonic() + PATIENT_S
        while not any(entry["event"] == "certificate_taken" for entry in daemon.lines()):
            assert time.monotonic() < give_up_s
            time.sleep(0.1)
        with client(daemon, after) as asker:
            assert asker.get("/health/ready", headers=operator).json()["ready"]
        assert daemon.stop() == 0
