"""Repositories behind a web server, and servers that are none."""

import os
import socket
import ssl
import threading
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import partial
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from roadgrip.release import bundle_target
from rsu_app.adapters.updates import FetchLimits
from rsu_app.rollout_ports import UpdateReason
from tests.bundles import MODEL_NAME
from tests.rsu_app.adapters.updates.sites import content_of


class Quiet:
    """Mixed into a handler: no line on standard error for every request."""

    def log_message(self, *_args):
        pass


class QuietServer(ThreadingHTTPServer):
    def handle_error(self, *_args):
        """Say nothing of a client that hangs up."""


class FolderHandler(Quiet, SimpleHTTPRequestHandler):
    pass


@contextmanager
def serving(handler):
    """Yield the address of a server that answers with a handler."""
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=partial(server.serve_forever, poll_interval=0.01))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()


def answering(respond):
    """Return a handler that answers every request with a function of itself."""

    class Handler(Quiet, BaseHTTPRequestHandler):
        def do_GET(self):
            respond(self)

    return Handler


@contextmanager
def trickling(beginning, drop, *, pause_s):
    """Yield the address of a server that says the beginning, then drop after drop until nobody listens."""
    ended = threading.Event()

    def serve(listener):
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            with connection:
                try:
                    connection.sendall(beginning)
                    while drop and not ended.wait(pause_s):
                        connection.sendall(drop)
                    ended.wait()
                except OSError:
                    pass

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve, args=(listener,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            ended.set()
            # Only this wakes a thread that waits for a connection.
            listener.shutdown(socket.SHUT_RDWR)
            thread.join()


# Servers that are one ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["", "/", "/below", "/below/"])
def test_a_release_comes_over_http(site, tmp_path, path):
    site.repository.release(site.bundle(), sequence_number=1)
    (site.repository.folder / "below").symlink_to(site.repository.folder)
    with serving(partial(FolderHandler, directory=str(site.repository.folder))) as address:
        assert site.fetched(site.source(address + path)).release.sequence_number == 1
        assert content_of(site.shelf.incoming_folder) == content_of(site.bundle())
        assert site.fetch(site.source(address + path), newer_than=1) is None


def test_keys_that_changed_are_followed_over_http(site):
    for _ in range(3):
        site.repository.rotate("root", "targets")
    site.repository.release(site.bundle(), sequence_number=1)
    with serving(partial(FolderHandler, directory=str(site.repository.folder))) as address:
        assert site.fetched(site.source(address)).release.sequence_number == 1


def test_proxies_of_the_environment_are_not_asked(site, monkeypatch):
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    site.repository.release(site.bundle(), sequence_number=1)
    with serving(partial(FolderHandler, directory=str(site.repository.folder))) as address:
        assert site.fetched(site.source(address))


def test_a_file_that_was_changed_on_the_server_is_refused(site):
    release = site.run_first_release().live
    site.repository.place_of(bundle_target(release.bundle_id, MODEL_NAME)).write_bytes(b"another model")
    with serving(partial(FolderHandler, directory=str(site.repository.folder))) as address:
        assert site.reason(site.source(address)) is UpdateReason.TAMPERED


# Servers that are none -----------------------------------------------------------------------------------------------


def answer(status, *, headers=(), content=b""):
    def respond(handler):
        handler.send_response(status)
        for name, value in headers:
            handler.send_header(name, value)
        handler.end_headers()
        handler.wfile.write(content)

    return respond


@pytest.mark.parametrize("status", [204, 301, 302, 400, 401, 403, 404, 500, 503])
def test_a_server_that_has_no_repository_is_told_of(site, status):
    headers = [("Location", "/elsewhere")] if status in {301, 302} else []
    with serving(answering(answer(status, headers=headers))) as address:
        refusal = site.refusal(site.source(address))
    assert refusal.reason is UpdateReason.UNREACHABLE
    assert str(status) in refusal.detail


def test_a_page_that_wants_a_login_is_no_repository(site):
    with serving(answering(answer(200, content=b"<html>Please log in</html>"))) as address:
        assert site.reason(site.source(address)) is UpdateReason.MALFORMED


@pytest.mark.parametrize(
    ("headers", "content"),
    [
        ([("Content-Length", "1000")], b"{"),
        ([("Transfer-Encoding", "chunked")], b"5\r\n{"),
        ([("Transfer-Encoding", "chunked")], b"no length\r\n"),
    ],
)
def test_a_connection_that_ends_early_is_not_taken_for_a_forgery(site, headers, content):
    def respond(handler):
        handler.protocol_version = "HTTP/1.1"
        handler.close_connection = True
        answer(200, headers=headers, content=content)(handler)

    with serving(answering(respond)) as address:
        assert site.reason(site.source(address)) is UpdateReason.UNREACHABLE


def test_a_file_without_end_ends_at_its_signed_length(site):
    site.repository.release(site.bundle(), sequence_number=1)
    folder = site.repository.folder

    def respond(handler):
        name = handler.path.lstrip("/")
        if not name.startswith("targets/bundles/"):
            content = (folder / name).read_bytes() if (folder / name).is_file() else None
            answer(404 if content is None else 200, content=content or b"")(handler)
            return
        answer(200)(handler)
        try:
            while True:
                handler.wfile.write(b"x" * 65_536)
        except OSError:
            pass

    with serving(answering(respond)) as address:
        assert site.reason(site.source(address)) is UpdateReason.TAMPERED


def test_a_port_nobody_listens_at_is_told_of(site):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    refusal = site.refusal(site.source(f"http://127.0.0.1:{port}"))
    assert refusal.reason is UpdateReason.UNREACHABLE
    assert "refused" in refusal.detail


# Servers that take their time ----------------------------------------------------------------------------------------

HEAD = b"HTTP/1.1 200 OK\r\n"


@pytest.mark.parametrize(
    ("beginning", "drop"),
    [
        (b"", b""),
        (b"HTTP/1.1 2", b""),
        (HEAD + b"Content-Length: 1000\r\n\r\n{", b""),
    ],
    ids=["says nothing", "stops in its first line", "stops in the content"],
)
def test_a_server_that_falls_silent_is_not_waited_for(site, beginning, drop):
    # The total is far off: what ends the visit is the silence.
    limits = FetchLimits(silence_s=0.05, total_s=3_600.0)
    with trickling(beginning, drop, pause_s=0.0) as address:
        refusal = site.refusal(site.source(address, limits=limits))
    assert refusal.reason is UpdateReason.UNREACHABLE
    assert "timed out" in refusal.detail


@pytest.mark.parametrize(
    ("beginning", "drop"),
    [
        (b"", b"H"),
        (HEAD, b"X-Header: of many\r\n"),
        (HEAD + b"X-Long: ", b"x"),
        (b"", b"HTTP/1.1 100 Continue\r\n\r\n"),
        (HEAD + b"Content-Length: 100000\r\n\r\n", b"{"),
        (HEAD + b"\r\n", b"{"),
        (HEAD + b"Transfer-Encoding: chunked\r\n\r\n", b"1\r\n{\r\n"),
        (HEAD + b"Transfer-Encoding: chunked\r\n\r\n", b"0"),
    ],
    ids=["line", "headers", "header", "continue", "content", "no length", "chunks", "chunk's length"],
)
def test_a_server_that_trickles_is_not_waited_for_either(site, beginning, drop):
    # Never silent for long: what ends the visit is the total.
    limits = FetchLimits(silence_s=3_600.0, total_s=0.15)
    with trickling(beginning, drop, pause_s=0.01) as address:
        assert site.reason(site.source(address, limits=limits)) is UpdateReason.UNREACHABLE


def test_the_total_is_for_all_files_together(site):
    site.repository.release(site.bundle(), sequence_number=1)
    with serving(partial(FolderHandler, directory=str(site.repository.folder))) as address:
        refusal = site.refusal(site.source(address, limits=FetchLimits(total_s=1e-9)))
    assert refusal.reason is UpdateReason.UNREACHABLE
    assert "longer than" in refusal.detail


# Certificates --------------------------------------------------------------------------------------------------------


def own_certificate(folder):
    """Return the path of a key and a certificate for 127.0.0.1 that nobody but itself vouches for."""
    key, name = ec.generate_private_key(ec.SECP256R1()), x509.Name([])
    now = datetime.now(UTC)
    certificate = (
        x509.CertificateBuilder(name, name, key.public_key(), 1, now - timedelta(1), now + timedelta(1))
        .add_extension(x509.SubjectAlternativeName([x509.DNSName("localhost")]), critical=True)
        .sign(key, hashes.SHA256())
    )
    path = folder / "server.pem"
    path.write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
        + certificate.public_bytes(serialization.Encoding.PEM)
    )
    return path


@contextmanager
def serving_encrypted(folder, certificate):
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    with QuietServer(("127.0.0.1", 0), partial(FolderHandler, directory=str(folder))) as server:
        server.socket = context.wrap_socket(server.socket, server_side=True)
        thread = threading.Thread(target=partial(server.serve_forever, poll_interval=0.01))
        thread.start()
        try:
            yield f"https://localhost:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()


def test_a_certificate_nobody_vouches_for_is_refused_and_one_the_machine_knows_is_not(site, monkeypatch):
    site.repository.release(site.bundle(), sequence_number=1)
    certificate = own_certificate(site.folder)
    with serving_encrypted(site.repository.folder, certificate) as address:
        refusal = site.refusal(site.source(address))
        assert refusal.reason is UpdateReason.UNREACHABLE
        assert "certificate" in refusal.detail
        # How OpenSSL is told of the machine's list.
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
        assert site.fetched(site.source(address)).release.sequence_number == 1


# Folders -------------------------------------------------------------------------------------------------------------


def test_a_pipe_in_a_folder_is_not_waited_for(site):
    site.repository.release(site.bundle(), sequence_number=1)
    path = site.repository.metadata_folder / "timestamp.json"
    path.unlink()
    os.mkfifo(path)
    assert site.reason() is UpdateReason.UNREACHABLE


def test_a_folder_that_takes_too_long_is_not_waited_for(site):
    site.repository.release(site.bundle(), sequence_number=1)
    refusal = site.refusal(site.source(limits=FetchLimits(total_s=1e-9)))
    assert refusal.reason is UpdateReason.UNREACHABLE
    assert "longer than" in refusal.detail


def test_a_file_that_cannot_be_read_is_told_of(site, monkeypatch):
    site.repository.release(site.bundle(), sequence_number=1)
    (site.repository.metadata_folder / "timestamp.json").unlink()
    # A file that cannot be read whoever asks, unlike one without rights.
    (site.repository.metadata_folder / "timestamp.json").symlink_to("/proc/self/mem")
    refusal = site.refusal()
    assert refusal.reason is UpdateReason.UNREACHABLE
    assert "timestamp.json" in refusal.detail
