"""TLS for HTTP: the unit's certificate, read anew when its files change, and a warning long before it ends."""

from __future__ import annotations

import os
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509

from roadgrip.errors import ConfigurationError
from rsu_app.secret_files import FileWatch, read_public, read_secret
from rsu_app.usecases import Check

WARN_BEFORE_DAYS = 14.0
"""How long before its end a certificate is no longer as it should be."""
DAY_S = 86_400.0
_CIPHERS = "ECDHE+AESGCM:ECDHE+CHACHA20"
"""For TLS 1.2: what a recorded conversation stays secret with. TLS 1.3 has nothing else."""


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """Where everything lies.

    Attributes:
        certificate: The unit's own, its chain behind it.
        key: Its private key.
        client_authorities: Who vouches for clients; None lets in clients without a certificate.
    """

    certificate: Path
    key: Path
    client_authorities: Path | None = None


class ServerTls:
    """The TLS of the unit, with the certificate that its files hold now.

    A certificate that ended, or that the unit's clock takes for ended, is shown all the same: whether to trust it is
    for the client to say, and a wrong clock must not close the unit.

    Args:
        files: Where everything lies. Authorities of clients are read once; to take one away, start the unit anew.

    Raises:
        ConfigurationError: Something cannot be used; the message names the setting.
    """

    def __init__(self, files: TlsFiles) -> None:
        self._files = files
        self._watch = FileWatch(files.certificate, files.key)
        self.trouble = ""
        self.context = _context(files.client_authorities)
        self.ends_unix_s = self._load()

    def refresh(self) -> bool:
        """Return whether the files had changed. New connections get the new certificate.

        Where the files do not fit each other, as in the middle of being replaced, the old one stays.
        """
        if not self._watch.changed():
            return False
        try:
            self.ends_unix_s, self.trouble = self._load(), ""
        except ConfigurationError as error:
            self.trouble = str(error)
        return True

    def days_left(self, *, now_unix_s: float) -> float:
        """Return how many days the certificate has left; negative once it ended.

        Args:
            now_unix_s: By the unit's wall clock.
        """
        return (self.ends_unix_s - now_unix_s) / DAY_S

    def check(self, *, now_unix_s: float) -> Check:
        """Return whether the certificate is as it should be. It is never required: a unit serves with an old one.

        Args:
            now_unix_s: By the unit's wall clock.
        """
        days = self.days_left(now_unix_s=now_unix_s)
        words = f"ends in {days:.0f} days" if days >= 0.0 else f"ended {-days:.0f} days ago"
        ok = days >= WARN_BEFORE_DAYS and not self.trouble
        trouble = f"; a newer one is not taken: {self.trouble}" if self.trouble else ""
        return Check("certificate", ok=ok, detail=f"the certificate of HTTPS {words}{trouble}", required=False)

    def _load(self) -> float:
        """Take the certificate and key as they are now, both or neither, and return when the certificate ends."""
        chain = read_public(self._files.certificate, setting="http.tls_certificate_file")
        key = read_secret(self._files.key, setting="http.tls_key_file")
        ends_unix_s = _end_unix_s(chain, path=self._files.certificate)
        with _named_copy(chain + b"\n" + key) as name:
            try:
                # Into another context first: the one in use would be left with half of a pair that does not fit.
                ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(name, password="")
                self.context.load_cert_chain(name, password="")
            except (ssl.SSLError, OSError, ValueError) as error:
                raise ConfigurationError(
                    f"http.tls_key_file: {self._files.key} is no key (PEM, without a password) for the certificate in "
                    f"{self._files.certificate}"
                ) from error
        return ends_unix_s


@contextmanager
def _named_copy(content: bytes) -> Iterator[str]:
    """Give a name to a copy in memory: one and the same is looked at twice, and no key is ever written to a disk."""
    descriptor = os.memfd_create("tls")
    with os.fdopen(descriptor, "wb", buffering=0) as copy:
        copy.write(content)
        yield f"/proc/self/fd/{descriptor}"


def _context(client_authorities: Path | None) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION | ssl.OP_NO_COMPRESSION
    context.set_ciphers(_CIPHERS)
    context.set_alpn_protocols(["http/1.1"])
    if client_authorities is not None:
        setting = "http.client_authorities_file"
        pems = read_public(client_authorities, setting=setting)
        try:
            context.load_verify_locations(cadata=pems.decode("ascii"))
        except (ssl.SSLError, ValueError) as error:
            raise ConfigurationError(f"{setting}: {client_authorities} holds no certificate (PEM)") from error
        context.verify_mode = ssl.CERT_REQUIRED
    return context


def _end_unix_s(chain: bytes, *, path: Path) -> float:
    """Return when the first certificate of a chain that ends does so."""
    try:
        certificates = x509.load_pem_x509_certificates(chain)
    except ValueError as error:
        raise ConfigurationError(f"http.tls_certificate_file: {path} holds no certificate (PEM)") from error
    return min(certificate.not_valid_after_utc.timestamp() for certificate in certificates)
