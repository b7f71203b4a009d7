"""Tokens that open what is for operators: what they look like, the file that knows them, and who may do what.

The file holds no token, only the SHA-256 of each, so whoever reads it can open nothing. A line of it::

    metrics,health 2c26b46b68ffc68ff99b453c1d30413413422d706483bfa0f98a5e886266e7ae prometheus in the control room
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from roadgrip.errors import ConfigurationError
from rsu_app.secret_files import read_secret

SETTING = "operators.tokens_file"
TOKEN_BYTES = 32
"""So many that nobody guesses one, however often he may try."""
TOKENS_LIMIT_COUNT = 100
NOTE_LIMIT_CHARS = 100
_PREFIX = "rg_"
"""So that a token that turns up where it should not be is known for what it is."""
_DIGEST = re.compile(r"[0-9a-f]{64}")


class TokenScope(StrEnum):
    """What a token opens."""

    METRICS = "metrics"
    """`GET /metrics`."""
    HEALTH = "health"
    """`GET /health/ready`, and its words on the page at `/`."""
    DETECTIONS = "detections"
    """`POST /v1/sections/{section_id}/detections`."""


@dataclass(frozen=True, slots=True)
class Token:
    """A token as the file knows it.

    Attributes:
        scopes: What it opens.
        digest: SHA-256 of it.
    """

    scopes: frozenset[TokenScope]
    digest: bytes


def new_token(scopes: Iterable[TokenScope], *, note: str = "") -> tuple[str, str]:
    """Return a new token, to be shown once, and the line of the file that lets it in.

    Args:
        scopes: What it shall open, at least one.
        note: Who has it, for whoever reads the file.

    Raises:
        ConfigurationError: It opens nothing, or the note is no line.
    """
    wanted = [scope.value for scope in TokenScope if scope in set(scopes)]
    if not wanted:
        raise ConfigurationError(f"a token needs a scope: {', '.join(TokenScope)}")
    if len(note) > NOTE_LIMIT_CHARS or not note.isprintable():
        raise ConfigurationError(f"a note is one line of at most {NOTE_LIMIT_CHARS} characters")
    token = _PREFIX + secrets.token_urlsafe(TOKEN_BYTES)
    return token, f"{','.join(wanted)} {digest_of(token).hex()} {note}".rstrip()


def digest_of(token: str) -> bytes:
    """Return what the file holds in a token's place."""
    return hashlib.sha256(token.encode()).digest()


def tokens_from_text(text: str) -> tuple[Token, ...]:
    """Return the tokens of a file; empty lines and those that start with # say nothing.

    Raises:
        ConfigurationError: A line is none; the message gives its number and does not repeat it.
    """
    found = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        scopes, _, rest = line.strip().partition(" ")
        digest = rest.strip().partition(" ")[0]
        try:
            opened = frozenset(TokenScope(scope) for scope in scopes.split(","))
        except ValueError:
            opened = frozenset()
        if not opened or not _DIGEST.fullmatch(digest):
            raise ConfigurationError(
                f"{SETTING}: line {number} is not `SCOPES SHA256 [NOTE]` with scopes of {', '.join(TokenScope)}; "
                "`roadgrip-rsu token new` makes such lines"
            )
        found.append(Token(opened, bytes.fromhex(digest)))
    if len(found) > TOKENS_LIMIT_COUNT:
        raise ConfigurationError(f"{SETTING}: more than {TOKENS_LIMIT_COUNT} tokens")
    return tuple(found)


def read_tokens(path: Path) -> tuple[Token, ...]:
    """Return the tokens of a file, which nobody but its owner may change.

    Raises:
        ConfigurationError: It cannot be read, others may read or write it, or a line is none.
    """
    try:
        text = read_secret(path, setting=SETTING).decode()
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{SETTING}: {path} is no text") from error
    return tokens_from_text(text)


def scopes_of(presented: str, tokens: Iterable[Token]) -> frozenset[TokenScope] | None:
    """Return what a presented token opens, None for one that nobody gave out.

    Takes as long for any token, so that nobody learns one bit by bit.
    """
    digest = digest_of(presented)
    found: frozenset[TokenScope] | None = None
    for token in tokens:
        if hmac.compare_digest(digest, token.digest):
            found = token.scopes if found is None else found | token.scopes
    return found
