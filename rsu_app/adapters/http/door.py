"""The door of HTTP: who gets in and by which certificate, both of which may change while the unit runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import structlog

from rsu_app.adapters.http.access import OperatorAccess
from rsu_app.usecases import Check

if TYPE_CHECKING:
    from rsu_app.adapters.http.tls import ServerTls

_log = structlog.get_logger("roadgrip")


@dataclass(frozen=True, slots=True)
class Door:
    """Who gets in, and how.

    Attributes:
        access: Who may ask what.
        tls: None speaks HTTP in the clear.
    """

    access: OperatorAccess
    tls: ServerTls | None = None

    @property
    def url_scheme(self) -> str:
        """How addresses of the unit begin."""
        return "http" if self.tls is None else "https"

    def refresh(self) -> None:
        """Take files that were replaced, and say so."""
        for name, part in (("tokens", self.access), ("certificate", self.tls)):
            if part is None or not part.refresh():
                continue
            if part.trouble:
                _log.error(f"{name}_not_taken", error=part.trouble)
            else:
                _log.info(f"{name}_taken")

    def checks(self, *, now_unix_s: float) -> tuple[Check, ...]:
        """Return what the door adds to the unit's readiness.

        Args:
            now_unix_s: By the unit's wall clock.
        """
        found: tuple[Check, ...] = () if self.tls is None else (self.tls.check(now_unix_s=now_unix_s),)
        if self.access.trouble:
            found += (Check("tokens", ok=False, detail=self.access.trouble, required=False),)
        return found
