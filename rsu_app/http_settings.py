"""What an operator may choose about HTTP: addresses, limits, TLS, and who may ask what."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, model_validator

from rsu_app.setting_groups import Address, Group, Port
from rsu_app.signatures import SignatureMode


class HttpSettings(Group):
    """HTTP: people, other machines, and vehicles over cellular."""

    host: Address = Field(
        default="127.0.0.1", description="Address to listen on; `0.0.0.0` opens the unit to its network."
    )
    port: Port = Field(default=8_080, description="TCP port.")
    body_limit_bytes: int = Field(
        default=65_536,
        ge=4_096,
        le=16_777_216,
        description="Largest request body; larger ones get 413 without being read.",
    )
    connections_limit_count: int = Field(
        default=512, ge=8, le=100_000, description="Connections at one time; more get 503."
    )
    connections_per_source_count: int = Field(
        default=64,
        ge=1,
        le=100_000,
        description="Connections of one address at one time; more get 503. The machine's own are not limited so.",
    )
    tls_certificate_file: Path | None = Field(
        default=None,
        description="Certificate of the unit with its chain (PEM): makes HTTP to HTTPS. Read anew when it changes.",
    )
    tls_key_file: Path | None = Field(
        default=None, description="Its private key (PEM), which nobody but owner and group may read."
    )
    client_authorities_file: Path | None = Field(
        default=None,
        description="Authorities (PEM) of clients: then whoever has no certificate of theirs is not let in at all.",
    )
    stream_clients_limit_count: int = Field(
        default=64, ge=1, le=10_000, description="Clients of the event stream at one time; more get 503."
    )
    stream_heartbeat_s: float = Field(
        default=15.0,
        gt=0.0,
        le=300.0,
        description="A silent event stream says so this often, so that a dead client is noticed.",
    )
    shutdown_s: int = Field(
        default=5, ge=1, le=120, description="How long open requests may take to finish when the unit stops."
    )
    signatures: SignatureMode = Field(
        default=SignatureMode.OFF,
        description="Signatures of messages over HTTP: `off` (taken off unread), `optional` (a signed one must "
        "verify), `required` (JSON passages are then refused).",
    )

    @model_validator(mode="after")
    def _whole_tls(self) -> HttpSettings:
        if (self.tls_certificate_file is None) != (self.tls_key_file is None):
            message = "tls_certificate_file and tls_key_file belong together"
            raise ValueError(message)
        if self.client_authorities_file is not None and self.tls_certificate_file is None:
            message = "client_authorities_file needs tls_certificate_file: only with TLS a client shows a certificate"
            raise ValueError(message)
        return self


class OperatorSettings(Group):
    """Who may read and order what is for operators, over HTTP: metrics, health, detections."""

    tokens_file: Path | None = Field(
        default=None,
        description="Tokens that open the operators' calls, from `roadgrip-rsu token new`, read anew when it changes; "
        "left out, only clients on the machine itself may call them.",
    )
