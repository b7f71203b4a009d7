import asyncio
import ssl
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, PrivateFormat

from roadgrip.errors import ConfigurationError
from rsu_app.adapters.http.connections import ConnectionLimits
from rsu_app.adapters.http.server import HttpServer, listening_socket
from rsu_app.adapters.http.tls import DAY_S, ServerTls, TlsFiles
from tests.rsu_app.adapters.http.certificates import Identity, make_identity
from tests.rsu_app.adapters.http.test_connections import GET, PATIENT_S, hello

CLOSING = GET.replace(b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n")


def server_tls(folder: Path, identity: Identity, *, clients_of: Identity | None = None) -> ServerTls:
    certificate, key = identity.write(folder, "unit")
    authorities = None
    if clients_of is not None:
        authorities, _ = clients_of.write(folder, "authority")
    return ServerTls(TlsFiles(certificate, key, authorities))


@asynccontextmanager
async def serving(tls: ServerTls):
    listener = listening_socket("127.0.0.1", 0)
    started = asyncio.Event()
    server = HttpServer(
        hello,
        limits=ConnectionLimits(connections_count=10),
        shutdown_s=1,
        on_start=started.set,
        on_stop=lambda: None,
        tls=tls.context,
    )
    task = asyncio.create_task(server.serve(sockets=[listener]))
    await started.wait()
    try:
        yield listener.getsockname()[1]
    finally:
        server.stop()
        await asyncio.wait_for(task, PATIENT_S)


def client(trusted: Identity, *, shows: tuple[Path, Path] | None = None, newest: ssl.TLSVersion | None = None):
    context = ssl.create_default_context(cadata=trusted.certificate_pem.decode())
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    if shows is not None:
        context.load_cert_chain(*shows)
    if newest is not None:
        context.minimum_version = ssl.TLSVersion.MINIMUM_SUPPORTED
        context.maximum_version = newest
    return context


async def ask(port: int, context: ssl.SSLContext) -> tuple[bytes, bytes, str]:
    """Return the answer, the certificate that was shown and the version that was agreed on."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context)
    shown = writer.get_extra_info("ssl_object")
    certificate, version = shown.getpeercert(binary_form=True), shown.version()
    writer.write(CLOSING)
    answer = await asyncio.wait_for(reader.read(), PATIENT_S)
    writer.close()
    return answer, certificate, version


async def said_to(port: int, context: ssl.SSLContext) -> bytes:
    """Return what a client is answered; nothing if he is turned away while TLS is agreed on."""
    try:
        return (await ask(port, context))[0]
    except (ssl.SSLError, ConnectionError):
        return b""


def test_a_client_who_trusts_the_certificate_is_answered(tmp_path):
    unit = make_identity("unit", authority=True)

    async def story():
        async with serving(server_tls(tmp_path, unit)) as port:
            return await ask(port, client(unit))

    answer, certificate, version = asyncio.run(story())
    assert answer.endswith(b"hello")
    assert certificate == unit.certificate.public_bytes(Encoding.DER)
    assert version == "TLSv1.3"


@pytest.mark.parametrize("newest", [ssl.TLSVersion.TLSv1_1, ssl.TLSVersion.TLSv1])
@pytest.mark.filterwarnings("ignore:ssl.TLSVersion:DeprecationWarning")
def test_old_versions_of_tls_are_refused(tmp_path, newest):
    unit = make_identity("unit", authority=True)

    async def story():
        async with serving(server_tls(tmp_path, unit)) as port:
            assert (await ask(port, client(unit, newest=ssl.TLSVersion.TLSv1_2)))[2] == "TLSv1.2"
            with pytest.raises((ssl.SSLError, ConnectionError)):
                await ask(port, client(unit, newest=newest))

    asyncio.run(story())


def test_new_connections_get_a_new_certificate_without_a_restart(tmp_path):
    before, after = (make_identity("unit", days=days, authority=True) for days in (10.0, 90.0))
    tls = server_tls(tmp_path, before)

    async def story():
        async with serving(tls) as port:
            assert not tls.refresh()
            assert (await ask(port, client(before)))[0].endswith(b"hello")
            after.write(tmp_path, "unit")
            assert tls.refresh()
            assert (await ask(port, client(after)))[1] == after.certificate.public_bytes(Encoding.DER)

    asyncio.run(story())
    assert tls.days_left(now_unix_s=after.certificate.not_valid_after_utc.timestamp() - 3 * DAY_S) == 3.0


def test_a_pair_that_does_not_fit_is_not_taken_until_it_does(tmp_path):
    before, after = (make_identity("unit", authority=True) for _ in range(2))
    tls = server_tls(tmp_path, before)
    now_unix_s = before.certificate.not_valid_after_utc.timestamp() - 50.0 * DAY_S
    (tmp_path / "unit.crt").write_bytes(after.certificate_pem)

    async def story():
        async with serving(tls) as port:
            assert tls.refresh()
            assert not tls.check(now_unix_s=now_unix_s).ok
            assert "unit.key" in tls.trouble
            assert (await ask(port, client(before)))[0].endswith(b"hello")
            after.write(tmp_path, "unit")
            assert tls.refresh()
            assert tls.check(now_unix_s=now_unix_s).ok
            assert (await ask(port, client(after)))[0].endswith(b"hello")

    asyncio.run(story())


def test_with_authorities_for_clients_nobody_gets_in_without_a_certificate_of_theirs(tmp_path):
    unit = make_identity("unit", authority=True)
    authority, stranger = (make_identity(name, authority=True) for name in ("authority", "stranger"))
    known = make_identity("vehicle", issuer=authority).write(tmp_path, "known")
    unknown = make_identity("vehicle", issuer=stranger).write(tmp_path, "unknown")

    async def story():
        async with serving(server_tls(tmp_path, unit, clients_of=authority)) as port:
            assert (await ask(port, client(unit, shows=known)))[0].endswith(b"hello")
            for shows in (None, unknown):
                assert await said_to(port, client(unit, shows=shows)) == b""
            assert (await ask(port, client(unit, shows=known)))[0].endswith(b"hello")

    asyncio.run(story())


def test_a_readiness_that_warns_two_weeks_before_the_end(tmp_path):
    unit = make_identity("unit")
    tls = server_tls(tmp_path, unit)
    end_unix_s = unit.certificate.not_valid_after_utc.timestamp()
    found = {days: tls.check(now_unix_s=end_unix_s - days * DAY_S) for days in (15, 13, -3)}
    assert [check.ok for check in found.values()] == [True, False, False]
    assert "ends in 13 days" in found[13].detail
    assert "ended 3 days ago" in found[-3].detail
    assert not any(check.required for check in found.values())


def test_a_certificate_that_ended_is_shown_all_the_same(tmp_path):
    unit = make_identity("unit", days=-1.0, authority=True)
    context = client(unit)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE

    async def story():
        async with serving(server_tls(tmp_path, unit)) as port:
            return await ask(port, context)

    assert asyncio.run(story())[0].endswith(b"hello")


def test_a_key_that_others_may_read_is_refused(tmp_path):
    certificate, key = make_identity("unit").write(tmp_path, "unit")
    key.chmod(0o644)
    with pytest.raises(ConfigurationError, match=r"http.tls_key_file: others may .*mode 0644"):
        ServerTls(TlsFiles(certificate, key))


def test_a_key_with_a_password_is_refused_and_nobody_is_asked_for_it(tmp_path):
    unit = make_identity("unit")
    certificate, key = unit.write(tmp_path, "unit")
    key.write_bytes(unit.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"secret")))
    with pytest.raises(ConfigurationError, match="without a password"):
        ServerTls(TlsFiles(certificate, key))


@pytest.mark.parametrize(
    ("broken", "setting"),
    [("unit.crt", "http.tls_certificate_file"), ("unit.key", "http.tls_key_file")],
)
def test_files_that_hold_something_else_are_named(tmp_path, broken, setting):
    certificate, key = make_identity("unit").write(tmp_path, "unit")
    (tmp_path / broken).write_bytes(b"rubbish")
    with pytest.raises(ConfigurationError, match=setting):
        ServerTls(TlsFiles(certificate, key))
    (tmp_path / broken).unlink()
    with pytest.raises(ConfigurationError, match=f"{setting}: cannot read"):
        ServerTls(TlsFiles(certificate, key))


def test_authorities_that_are_none_are_named(tmp_path):
    certificate, key = make_identity("unit").write(tmp_path, "unit")
    authorities = tmp_path / "authorities"
    for content in (b"rubbish", b"", b"\xff"):
        authorities.write_bytes(content)
        with pytest.raises(ConfigurationError, match=r"http\.client_authorities_file"):
            ServerTls(TlsFiles(certificate, key, authorities))
