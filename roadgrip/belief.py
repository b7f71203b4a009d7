"""Whether a signed message is believed: pure rules over who signed it, what was claimed, and what it says.

A unit believes a vehicle that is certified as one and spoke just now. A vehicle believes a unit that is certified for
the section, about the map and until the moment that it claims. Without a clock that can be trusted dates are not
judged; signatures, roles, sections and what was revoked are.
"""

from __future__ import annotations

from roadgrip.certificates import Role
from roadgrip.errors import WireError
from roadgrip.frames import section_key_of
from roadgrip.reasons import Reason
from roadgrip.records import AdvisoryNotice, Beacon, MapOffer, Message, Receipt
from roadgrip.signing import Claims, Signed

REPLAY_WINDOW_S = 300.0
"""How far a vehicle's clock may differ from the unit's: its message was sent no longer ago, and not so far ahead."""
MAP_HOLDS_S = 86_400
RECEIPT_HOLDS_S = 300


def unit_claims(message: Message, *, section_id: str, map_version: str, issued_unix_s: int | None) -> Claims:
    """Return what a unit claims of a message that it sends.

    Args:
        message: What it says; advice and beacons hold for as long as they may be shown.
        section_id: The section it is about; nothing where the unit does not know, and then nobody believes it.
        map_version: The unit's map of that section.
        issued_unix_s: Now; None while the unit's clock cannot be trusted, and then no expiry is claimed.
    """
    match message:
        case AdvisoryNotice():
            holds_s = message.advisory.valid_for_s
        case Beacon():
            holds_s = message.valid_for_s
        case Receipt():
            holds_s = RECEIPT_HOLDS_S
        case _:
            holds_s = MAP_HOLDS_S
    expires_unix_s = None if issued_unix_s is None else issued_unix_s + int(holds_s)
    return Claims(issued_unix_s, expires_unix_s, section_id, map_version)


def check_vehicle(signed: Signed, *, now_unix_s: float | None, replay_window_s: float = REPLAY_WINDOW_S) -> None:
    """Do nothing if a unit believes the vehicle that has signed a message.

    Args:
        signed: Who, and what was claimed.
        now_unix_s: The unit's wall clock; None while it cannot be trusted, and then no date is judged.
        replay_window_s: How far the time of sending may be from now, either way.

    Raises:
        WireError: NOT_PERMITTED, OUTSIDE_REPLAY_WINDOW or CERTIFICATE_EXPIRED.
    """
    certificate, claims = signed
    if certificate.role is not Role.VEHICLE:
        raise WireError(Reason.NOT_PERMITTED, f"certified as a {certificate.role.value}, not as a vehicle")
    if now_unix_s is None:
        return
    issued_unix_s = claims.issued_unix_s
    if issued_unix_s is None:
        raise WireError(Reason.OUTSIDE_REPLAY_WINDOW, "it does not say when it was sent")
    if abs(now_unix_s - issued_unix_s) > replay_window_s:
        raise WireError(Reason.OUTSIDE_REPLAY_WINDOW, f"sent {now_unix_s - issued_unix_s:.0f} s before the unit's now")
    if not certificate.in_date(issued_unix_s):
        raise WireError(Reason.CERTIFICATE_EXPIRED, "the certificate does not hold at the time of sending")


def check_unit(message: Message, signed: Signed, *, section_key: bytes, now_unix_s: float | None) -> None:
    """Do nothing if a vehicle believes the unit that has signed a message.

    Args:
        message: What it says.
        signed: Who has signed it, and what was claimed.
        section_key: The section of the exchange, from the frames; the vehicle knows its own.
        now_unix_s: The vehicle's wall clock; None if it has none that can be trusted, and then no date is judged.

    Raises:
        WireError: NOT_PERMITTED, MALFORMED, CERTIFICATE_EXPIRED or OUTSIDE_REPLAY_WINDOW.
    """
    certificate, claims = signed
    if not certificate.speaks_for(claims.section_id) or not claims.section_id:
        raise WireError(Reason.NOT_PERMITTED, f"not certified to speak for section {claims.section_id or 'unnamed'}")
    said = _place_of(message)
    if section_key_of(claims.section_id) != section_key or said not in {None, (claims.section_id, claims.map_version)}:
        raise WireError(Reason.MALFORMED, "the signature is for another section or map than the message")
    if now_unix_s is not None:
        if not certificate.in_date(now_unix_s):
            raise WireError(Reason.CERTIFICATE_EXPIRED, "the unit's certificate does not hold now")
        if claims.expires_unix_s is not None and now_unix_s > claims.expires_unix_s:
            raise WireError(Reason.OUTSIDE_REPLAY_WINDOW, f"held until {now_unix_s - claims.expires_unix_s:.0f} s ago")
    if isinstance(message, Beacon):
        check_broadcast(signed)


def check_broadcast(signed: Signed) -> None:
    """Do nothing if what was sent to all says until when it holds; without, it could be played again for ever.

    An answer needs no such end: it names the exchange that its receiver has just drawn.

    Raises:
        WireError: OUTSIDE_REPLAY_WINDOW.
    """
    if signed.claims.expires_unix_s is None:
        raise WireError(Reason.OUTSIDE_REPLAY_WINDOW, "sent to all without an end")


def _place_of(message: Message) -> tuple[str, str] | None:
    """Return the section and map that a unit's message is about, where it says so."""
    match message:
        case MapOffer():
            return message.section.section_id, message.section.version
        case AdvisoryNotice() | Beacon():
            return message.section_id, message.map_version
        case _:
            return None
