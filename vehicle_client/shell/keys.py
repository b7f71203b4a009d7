"""The keys a vehicle signs with and believes, and the codecs that use them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from roadgrip.errors import ConfigurationError
from roadgrip.signing import Signer, Verifier, signer_from_pem, verifier_from_pems
from vehicle_client.shell.codec import WireCodec

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

_Read = TypeVar("_Read")

INCOMPLETE_WALL_S = 5.0
"""How long the pieces of a map may take to come together, on the wall."""


@dataclass(frozen=True, slots=True)
class Keys:
    """What a vehicle signs with and whom it believes.

    Attributes:
        signer: Signs what is sent; None sends unsigned.
        verifier: The units that are believed; None believes everybody.
    """

    signer: Signer | None = None
    verifier: Verifier | None = None

    def codecs_for(self, section_id: str, *, speedup_ratio: float = 1.0) -> Callable[[bytes], WireCodec]:
        """Return what makes the codec of an exchange about a section from a passage's id.

        Args:
            section_id: The section.
            speedup_ratio: How fast the exchange's clock runs.
        """

        def open_codec(passage_id: bytes) -> WireCodec:
            return WireCodec(
                passage_id,
                section_id=section_id,
                timeout_s=INCOMPLETE_WALL_S * speedup_ratio,
                signer=self.signer,
                verifier=self.verifier,
            )

        return open_codec


def read_keys(signing_key: Path | None, trusted_keys: Sequence[Path]) -> Keys:
    """Return the keys in PEM files; with trusted keys, unsigned answers are not believed.

    Raises:
        ConfigurationError: A file cannot be read or holds no such key; the message names it.
    """
    signer = None if signing_key is None else _named(signing_key, signer_from_pem)
    if not trusted_keys:
        return Keys(signer, None)
    for path in trusted_keys:
        _named(path, lambda pem: verifier_from_pems([pem], required=True))
    return Keys(signer, verifier_from_pems([path.read_bytes() for path in trusted_keys], required=True))


def _named(path: Path, read: Callable[[bytes], _Read]) -> _Read:
    try:
        return read(path.read_bytes())
    except (OSError, ConfigurationError) as error:
        raise ConfigurationError(f"{path}: {error}") from error
