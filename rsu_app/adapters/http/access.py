"""Who may ask what. Vehicles and the public report passages and read advice; the rest is for operators.

One rule, and no default secret: with a file of tokens, whoever shows a token that opens a call may use it, from
wherever he is; without one, only clients on the machine itself may, and only if nobody stands between.
"""

from __future__ import annotations

from http import HTTPStatus
from pathlib import Path
from typing import Any

from fastapi import Request

from roadgrip.errors import ConfigurationError
from rsu_app.adapters.http.problems import ProblemError, documented
from rsu_app.loopback import is_loopback
from rsu_app.operator_tokens import Token, TokenScope, read_tokens, scopes_of
from rsu_app.secret_files import FileWatch

SCHEME_NAME = "operator"
SECURITY_SCHEMES: dict[str, Any] = {
    SCHEME_NAME: {
        "type": "http",
        "scheme": "bearer",
        "description": "A token from `roadgrip-rsu token new`. Without a file of tokens, clients on the machine itself "
        "need none.",
    }
}
OPERATORS_ONLY: dict[str, Any] = {"security": [{SCHEME_NAME: []}, {}]}
"""For the description of a call."""
OPERATOR_PROBLEMS = documented(HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN)

_FORWARDED = (b"forwarded", b"x-forwarded-for", b"x-real-ip", b"via")
"""Headers that a proxy adds: then the client is not on this machine, though the connection comes from here."""
_CHALLENGE = {"WWW-Authenticate": 'Bearer realm="roadgrip operators"'}


class OperatorAccess:
    """Knows the tokens, and reads them anew when their file changes.

    Args:
        tokens_file: None lets in clients on the machine itself, and nobody else.

    Raises:
        ConfigurationError: The file cannot be used.
    """

    def __init__(self, tokens_file: Path | None = None) -> None:
        self._path = tokens_file
        self._watch = None if tokens_file is None else FileWatch(tokens_file)
        self._tokens: tuple[Token, ...] | None = None if tokens_file is None else read_tokens(tokens_file)
        self.trouble = ""

    def refresh(self) -> bool:
        """Return whether the file had changed; a file that cannot be used opens nothing until it can."""
        if self._path is None or self._watch is None or not self._watch.changed():
            return False
        try:
            self._tokens, self.trouble = read_tokens(self._path), ""
        except ConfigurationError as error:
            self._tokens, self.trouble = (), str(error)
        return True

    def refusal(self, scope: TokenScope, request: Request) -> ProblemError | None:
        """Return why a request may not, None if it may."""
        if self._tokens is None:
            if _is_from_here(request):
                return None
            return ProblemError(
                "local_only",
                HTTPStatus.FORBIDDEN,
                "without operators.tokens_file only a client on the machine itself may ask this",
            )
        scheme, _, presented = request.headers.get("authorization", "").partition(" ")
        if scheme.lower() != "bearer" or not presented.strip():
            return ProblemError(
                "no_token", HTTPStatus.UNAUTHORIZED, f"show a token that opens {scope}", headers=_CHALLENGE
            )
        scopes = scopes_of(presented.strip(), self._tokens)
        if scopes is None:
            return ProblemError(
                "unknown_token", HTTPStatus.UNAUTHORIZED, "nobody gave out this token", headers=_CHALLENGE
            )
        if scope not in scopes:
            return ProblemError("wrong_token", HTTPStatus.FORBIDDEN, f"this token does not open {scope}")
        return None


def _is_from_here(request: Request) -> bool:
    client = request.client
    return (
        client is not None
        and is_loopback(client.host)
        and not any(name in _FORWARDED for name, _ in request.scope["headers"])
    )
