"""Who may ask what."""

import asyncio
import os
from pathlib import Path

import httpx
import pytest

from rsu_app.adapters.http.access import OperatorAccess
from rsu_app.operator_tokens import TokenScope, new_token
from tests.rsu_app.fakes import make_passage, make_section
from tests.rsu_app.sites import UnitUnderTest, make_unit, passage_json

SECTION = make_section()
HERE = f"/v1/sections/{SECTION.section_id}"
OPERATORS = [
    ("GET", "/metrics", TokenScope.METRICS),
    ("GET", "/health/ready", TokenScope.HEALTH),
    ("POST", f"{HERE}/detections", TokenScope.DETECTIONS),
]
PUBLIC = [
    ("GET", "/"),
    ("GET", "/health/live"),
    ("GET", "/openapi.json"),
    ("GET", "/docs"),
    ("GET", "/v1/sections"),
    ("GET", HERE),
    ("GET", f"{HERE}/map"),
    ("GET", f"{HERE}/advisory"),
    ("GET", f"{HERE}/friction"),
]
FAR = "192.0.2.7"


def asked(
    under_test: UnitUnderTest, method: str, path: str, *, client: str = FAR, **headers: str | bytes
) -> httpx.Response:
    async def ask() -> httpx.Response:
        transport = httpx.ASGITransport(app=under_test.app, client=(client, 1))
        async with httpx.AsyncClient(transport=transport, base_url="http://unit") as asker:
            given = [(name.encode(), v if isinstance(v, bytes) else v.encode()) for name, v in headers.items()]
            return await asker.request(method, path, headers=given, json={} if method == "POST" else None)

    return asyncio.run(ask())


def reason(answer: httpx.Response) -> tuple[int, str]:
    assert answer.headers["content-type"] == "application/problem+json"
    return answer.status_code, answer.json()["reason"]


class Tokens:
    """A file with a token for each scope."""

    def __init__(self, path: Path) -> None:
        self.path = path
        made = {scope: new_token([scope]) for scope in TokenScope}
        self.of = {scope: token for scope, (token, _) in made.items()}
        self.lines = {scope: line for scope, (_, line) in made.items()}
        self.write(*self.lines.values())

    def write(self, *lines: str) -> None:
        fresh = self.path.with_suffix(".new")
        fresh.write_text("\n".join(lines), encoding="utf-8")
        fresh.chmod(0o600)
        fresh.rename(self.path)


@pytest.fixture
def tokens(tmp_path):
    return Tokens(tmp_path / "tokens")


@pytest.mark.parametrize(("method", "path", "_scope"), OPERATORS)
@pytest.mark.parametrize("client", ["127.0.0.1", "::1", "::ffff:127.0.0.1"])
def test_without_tokens_the_machine_itself_may_ask(method, path, _scope, client):
    assert asked(make_unit(section=SECTION), method, path, client=client).status_code == 200


@pytest.mark.parametrize(("method", "path", "_scope"), OPERATORS)
@pytest.mark.parametrize("client", [FAR, "2001:db8::1", "somebody"])
def test_without_tokens_nobody_else_may(method, path, _scope, client):
    under_test = make_unit(section=SECTION)
    assert reason(asked(under_test, method, path, client=client)) == (403, "local_only")
    assert under_test.count("roadgrip_http_refusals_total", reason="local_only") == 1
    assert under_test.broadcasts == []


@pytest.mark.parametrize("header", ["x-forwarded-for", "forwarded", "via", "x-real-ip"])
def test_without_tokens_a_proxy_on_the_machine_is_not_the_machine_itself(header):
    answer = asked(make_unit(section=SECTION), "GET", "/metrics", client="127.0.0.1", **{header: "127.0.0.1"})
    assert reason(answer) == (403, "local_only")


@pytest.mark.parametrize(("method", "path", "scope"), OPERATORS)
@pytest.mark.parametrize("client", [FAR, "127.0.0.1"])
def test_a_token_opens_its_calls_from_wherever_and_no_others(tokens, method, path, scope, client):
    under_test = make_unit(section=SECTION, access=OperatorAccess(tokens.path))
    for held, token in tokens.of.items():
        answer = asked(under_test, method, path, client=client, authorization=f"Bearer {token}")
        if held is scope:
            assert answer.status_code == 200
        else:
            assert reason(answer) == (403, "wrong_token")
    assert under_test.count("roadgrip_http_refusals_total", reason="wrong_token") == len(tokens.of) - 1


@pytest.mark.parametrize(
    ("presented", "why"),
    [
        (None, "no_token"),
        ("", "no_token"),
        ("Bearer", "no_token"),
        ("Bearer  ", "no_token"),
        ("Basic cm9vdDpyb290", "no_token"),
        ("Bearer rg_guessed", "unknown_token"),
        ("Bearer é".encode("latin-1"), "unknown_token"),
    ],
)
@pytest.mark.parametrize("client", [FAR, "127.0.0.1"])
def test_with_tokens_nobody_gets_in_without_one(tokens, presented, why, client):
    under_test = make_unit(section=SECTION, access=OperatorAccess(tokens.path))
    headers = {} if presented is None else {"authorization": presented}
    answer = asked(under_test, "GET", "/metrics", client=client, **headers)
    assert reason(answer) == (401, why)
    assert answer.headers["www-authenticate"].startswith("Bearer")
    assert under_test.count("roadgrip_http_refusals_total", reason=why) == 1


def test_the_digest_of_a_token_opens_nothing(tokens):
    digest = tokens.lines[TokenScope.METRICS].split()[1]
    under_test = make_unit(section=SECTION, access=OperatorAccess(tokens.path))
    assert reason(asked(under_test, "GET", "/metrics", authorization=f"Bearer {digest}")) == (401, "unknown_token")


@pytest.mark.parametrize(("method", "path"), PUBLIC)
def test_what_is_for_everybody_needs_no_token(tokens, method, path):
    under_test = make_unit(section=SECTION, access=OperatorAccess(tokens.path))
    assert asked(under_test, method, path).status_code == 200


def test_a_vehicle_needs_no_token(tokens):
    under_test = make_unit(section=SECTION, access=OperatorAccess(tokens.path))

    async def report() -> httpx.Response:
        transport = httpx.ASGITransport(app=under_test.app, client=(FAR, 1))
        async with httpx.AsyncClient(transport=transport, base_url="http://unit") as vehicle:
            return await vehicle.post(f"{HERE}/passages", json=passage_json(make_passage(SECTION)))

    assert asyncio.run(report()).json()["counted"] is True


def test_a_file_that_changes_is_read_anew(tokens):
    access = OperatorAccess(tokens.path)
    under_test = make_unit(section=SECTION, access=access)
    token = tokens.of[TokenScope.METRICS]
    assert not access.refresh()
    tokens.write(tokens.lines[TokenScope.HEALTH])
    assert access.refresh()
    assert reason(asked(under_test, "GET", "/metrics", authorization=f"Bearer {token}")) == (401, "unknown_token")
    tokens.write(*tokens.lines.values())
    assert access.refresh()
    assert asked(under_test, "GET", "/metrics", authorization=f"Bearer {token}").status_code == 200


def test_a_file_that_became_unusable_opens_nothing(tokens):
    access = OperatorAccess(tokens.path)
    under_test = make_unit(section=SECTION, access=access)
    tokens.path.chmod(0o666)
    os.utime(tokens.path, ns=(1, 1))
    assert access.refresh()
    assert "others may" in access.trouble
    token = tokens.of[TokenScope.METRICS]
    answer = asked(under_test, "GET", "/metrics", client="127.0.0.1", authorization=f"Bearer {token}")
    assert reason(answer) == (401, "unknown_token")


def test_the_page_tells_strangers_nothing_of_the_unit():
    under_test = make_unit(section=SECTION, model=False)
    assert "no model is loaded" in asked(under_test, "GET", "/", client="127.0.0.1").text
    strange = asked(under_test, "GET", "/").text
    assert "60 km/h" in strange
    assert "not ready" not in strange
    assert "roadgrip 0" not in strange


def test_the_page_runs_nothing_and_may_not_be_framed():
    answer = asked(make_unit(section=SECTION), "GET", "/")
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "script-src" not in policy
    assert "frame-ancestors 'none'" in policy
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_the_description_says_which_calls_want_a_token():
    document = asked(make_unit(section=SECTION), "GET", "/openapi.json").json()
    guarded = {
        (method.upper(), path)
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
        if "security" in operation
    }
    template = "/v1/sections/{section_id}/detections"
    assert guarded == {("GET", "/metrics"), ("GET", "/health/ready"), ("POST", template)}
    assert document["components"]["securitySchemes"]["operator"]["scheme"] == "bearer"
    for method, path in guarded:
        assert {"401", "403"} <= document["paths"][path][method.lower()]["responses"].keys()
