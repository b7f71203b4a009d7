"""Cookies: how a unit finds out whether an ARRIVAL came from the address it names.

An ARRIVAL of fifty bytes asks for a map of thousands. Whoever writes another's address into it could have the unit
flood that one. So over UDP the first ARRIVAL is answered by a cookie, smaller than the question, and only who repeats
the question with it, and so has read what was sent to its address, is told more.

Nothing is remembered: a cookie is a keyed digest of address, exchange and time, and is computed again to be compared.
"""

from __future__ import annotations

import hashlib
import hmac
from math import floor

COOKIE_BYTES = 8
PERIOD_S = 300.0
"""A cookie holds until the end of the next period: five to ten minutes."""


class Cookies:
    """Makes cookies and knows its own again.

    Args:
        secret: At least 16 random bytes, drawn at the start and told to nobody.
    """

    def __init__(self, secret: bytes) -> None:
        if len(secret) < 16:
            raise ValueError("a secret of cookies has at least 16 bytes")
        self._secret = secret

    def cookie(self, *, host: str, port: int, exchange_id: bytes, now_s: float) -> bytes:
        """Return the cookie for an exchange with an address. 8 bytes.

        Args:
            host: The address a datagram came from.
            port: The port it came from.
            exchange_id: Of its frame.
            now_s: Any clock that never runs backwards.
        """
        return self._cookie(host, port, exchange_id, period=floor(now_s / PERIOD_S))

    def fits(self, cookie: bytes, *, host: str, port: int, exchange_id: bytes, now_s: float) -> bool:
        """Return whether a cookie was made for this address and exchange, now or a short while ago."""
        period = floor(now_s / PERIOD_S)
        return any(
            hmac.compare_digest(cookie, self._cookie(host, port, exchange_id, period=each))
            for each in (period, period - 1)
        )

    def _cookie(self, host: str, port: int, exchange_id: bytes, *, period: int) -> bytes:
        place = f"{host} {port} {period}".encode()
        return hashlib.blake2s(exchange_id + place, key=self._secret[:32], digest_size=COOKIE_BYTES).digest()
