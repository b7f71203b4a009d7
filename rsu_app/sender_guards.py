"""What each sender of frames may do at most, and how it is known whether it is where it says."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

from rsu_app.cookies import Cookies
from rsu_app.loopback import is_loopback
from rsu_app.quota import PassageQuota
from rsu_app.rate import RateLimitEach

if TYPE_CHECKING:
    from roadgrip.records import Passage


class SenderGuards:
    """The bounds for single senders; without arguments there are none.

    Args:
        cookies: Made for addresses that nobody has seen answering; None asks for none.
        frames_per_s: Frames that one address may send in a second; None does not count them.
        free_hosts: Addresses that are not counted, such as that of a radio that hands on what all vehicles send. This
            machine's own are not counted, either.
        passages_quota: Passages that one certificate may report; None does not count them.
    """

    def __init__(
        self,
        *,
        cookies: Cookies | None = None,
        frames_per_s: float | None = None,
        free_hosts: Collection[str] = (),
        passages_quota: PassageQuota | None = None,
    ) -> None:
        self._cookies = cookies
        self._frames = None if frames_per_s is None else RateLimitEach(frames_per_s)
        self._free_hosts = frozenset(free_hosts)
        self._passages_quota = passages_quota

    def frame_allowed(self, host: str, *, now_s: float) -> bool:
        """Return whether one more frame of an address is read, and count it if so."""
        if self._frames is None or not host or host in self._free_hosts or is_loopback(host):
            return True
        return self._frames.take(host, now_s=now_s)

    def passage_allowed(self, passage: Passage, *, certificate_id: bytes, now_s: float) -> bool:
        """Return whether a certificate may report this passage, and count it if so."""
        quota = self._passages_quota
        return quota is None or quota.take(
            certificate_id=certificate_id,
            section_id=passage.section_id,
            passage_id=passage.passage_id,
            now_s=now_s,
        )

    def cookie_wanted(self, shown: bytes, *, host: str, port: int, exchange_id: bytes, now_s: float) -> bytes | None:
        """Return the cookie that an address should show, None if it showed one that fits or none is asked for."""
        if self._cookies is None or self._cookies.fits(
            shown, host=host, port=port, exchange_id=exchange_id, now_s=now_s
        ):
            return None
        return self._cookies.cookie(host=host, port=port, exchange_id=exchange_id, now_s=now_s)
