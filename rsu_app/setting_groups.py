"""What an operator may choose, group by group; every default is safe.

`rsu_app.settings` puts the groups together and reads them; `deploy/README.md` shows them as a table.
"""

from __future__ import annotations

from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from roadgrip.belief import REPLAY_WINDOW_S
from roadgrip.units import WINDOW_S, kph_to_mps
from rsu_app.signatures import SignatureMode

Port = Annotated[int, Field(ge=0, le=65_535)]
"""A UDP or TCP port; 0 lets the machine choose, which tests use."""


def _address(value: str) -> str:
    if value:
        ip_address(value)
    return value


Address = Annotated[str, AfterValidator(_address)]
"""A literal IPv4 or IPv6 address: a unit beside a road must not hang on a name server."""


class Group(BaseModel):
    """Settings that belong together."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class DatabaseSettings(Group):
    """Where passages are kept, and for how long."""

    path: Path = Field(default=Path("roadgrip.sqlite3"), description="SQLite file; its folder is made if missing.")
    queue_limit_count: int = Field(
        default=1_024, ge=1, le=100_000, description="Passages that may wait for a commit; more are refused as `busy`."
    )
    retention_s: float = Field(
        default=7 * 86_400.0,
        ge=WINDOW_S,
        description="Stored passages older than this are deleted, never those of the window; an export may ask for "
        "more.",
    )
    rows_limit_count: int = Field(
        default=1_000_000, ge=1_000, description="Passages that may be stored; the oldest make room."
    )
    prune_period_s: float = Field(default=600.0, ge=1.0, description="How often old passages are looked for.")


class ExportSettings(Group):
    """Whether passages are kept for the laboratory, and how many."""

    enabled: bool = Field(
        default=False,
        description="Whether passages are kept for `roadgrip-rsu export`, without which it refuses.",
    )
    retention_s: float = Field(
        default=90 * 86_400.0,
        ge=WINDOW_S,
        description="How long passages are kept if so, `database.retention_s` if that is longer.",
    )
    size_limit_bytes: int = Field(
        default=512 * 1024 * 1024,
        ge=64 * 1024 * 1024,
        description="What the database may hold if so; the oldest passages make room, however young.",
    )
    unit_name: str = Field(
        default="", max_length=64, description="Name of the unit in exports; must be given if they are enabled."
    )

    @model_validator(mode="after")
    def _named(self) -> ExportSettings:
        if self.enabled and not self.unit_name.strip():
            message = "enabled needs unit_name, or nobody could tell whose passages an export holds"
            raise ValueError(message)
        return self


class SectionSettings(Group):
    """One section the unit serves."""

    file: str = Field(
        min_length=1,
        description="Path of a section file (`.json`), or the name of a packaged one, such as `long-turn`.",
    )
    winter_speed_mps: float | None = Field(
        default=None,
        ge=1.0,
        le=60.0,
        description="Winter speed of this section; left out, `advisory.winter_speed_mps` holds.",
    )


class ModelSettings(Group):
    """The model that turns a passage into friction."""

    bundle_path: Path | None = Field(
        default=None, description="Folder of a model bundle; left out, the packaged default is used."
    )


class WindowSettings(Group):
    """How many vehicles make an interval, and how long it holds."""

    length_s: float = Field(default=WINDOW_S, ge=60.0, le=86_400.0, description="How long a passage counts.")
    provisional_from_count: int = Field(
        default=10, ge=1, description="Vehicles from which the interval is provisional; below it is insufficient."
    )
    recommended_from_count: int = Field(default=50, ge=1, description="Vehicles from which it is recommended.")
    stale_after_s: float = Field(
        default=1_800.0,
        gt=0.0,
        le=86_400.0,
        description="Age of the newest passage from which the window says nothing about now.",
    )
    valid_at_most_s: float = Field(
        default=300.0,
        gt=0.0,
        le=86_400.0,
        description="Longest time a published interval may be used after it was read.",
    )

    @model_validator(mode="after")
    def _in_order(self) -> WindowSettings:
        if self.recommended_from_count < self.provisional_from_count:
            message = "recommended_from_count must not be below provisional_from_count"
            raise ValueError(message)
        return self


class ChangeDetectionSettings(Group):
    """Whether friction that changes within the hour cuts the window, and what it takes. Amounts are of ln mu."""

    enabled: bool = Field(
        default=False, description="Whether estimates from before a change of the friction stop counting."
    )
    clip_ratio: float = Field(
        default=0.2, gt=0.0, le=2.0, description="No single vehicle's deviation adds more than this."
    )
    slack_ratio: float = Field(
        default=0.11,
        gt=0.0,
        le=2.0,
        description="What every deviation is lessened by; above what the wear of tyres spreads.",
    )
    drop_threshold_ratio: float = Field(default=0.5, gt=0.0, le=20.0, description="Sum at which a drop is believed.")
    rise_threshold_ratio: float = Field(
        default=1.0, gt=0.0, le=20.0, description="Sum at which a rise is believed; not below that of a drop."
    )
    reference_count: int = Field(
        default=30, ge=1, le=200, description="Vehicles whose median is what was found before."
    )
    reference_from_count: int = Field(
        default=6, ge=1, le=200, description="With fewer than this there is no telling what was found before."
    )
    lag_count: int = Field(
        default=8, ge=1, le=200, description="Newest vehicles that are not yet part of what was found before."
    )
    kept_count: int = Field(default=10, ge=10, le=500, description="The newest vehicles that count whatever changed.")
    watched_count: int = Field(
        default=1_000, ge=500, le=1_000, description="The newest vehicles that are looked at; bounds the work."
    )

    @model_validator(mode="after")
    def _in_order(self) -> ChangeDetectionSettings:
        if not self.slack_ratio < self.clip_ratio:
            message = "slack_ratio must lie below clip_ratio, or no change is ever seen"
            raise ValueError(message)
        if not self.drop_threshold_ratio <= self.rise_threshold_ratio:
            message = "rise_threshold_ratio must not be below drop_threshold_ratio"
            raise ValueError(message)
        if self.reference_from_count > self.reference_count:
            message = "reference_from_count must not be above reference_count"
            raise ValueError(message)
        return self


class AdvisorySettings(Group):
    """How careful the advice is."""

    winter_speed_mps: float = Field(
        default=kph_to_mps(60.0),
        ge=kph_to_mps(5.0),
        le=60.0,
        description="What is advised while too few vehicles passed or the unit cannot know better (default 60 km/h).",
    )
    utilisation_frac: float = Field(
        default=0.6, gt=0.0, le=1.0, description="Share of the friction that the curve may use up."
    )
    rise_margin_mps: float = Field(
        default=kph_to_mps(2.0),
        ge=0.0,
        le=10.0,
        description="By how much the curve speed must exceed the next step of 5 km/h before the advice rises to it.",
    )
    valid_for_s: float = Field(
        default=300.0, gt=0.0, le=86_400.0, description="How long an advice may be shown at most."
    )


class ProbingSettings(Group):
    """What is asked before advice changes while too few vehicles name a friction."""

    evidence_count: int = Field(
        default=10,
        ge=1,
        le=10_000,
        description="Vehicles that must have driven by an advice before it rises by a step; above 1000: never.",
    )
    named_frac: float = Field(
        default=0.1, ge=0.0, lt=1.0, description="It rises only while no larger share of them names a friction."
    )
    driven_frac: float = Field(
        default=0.9,
        gt=0.0,
        le=1.0,
        description="Who drives slower than this share of the advice shows nothing about it.",
    )
    heard_after_s: float = Field(
        default=300.0,
        ge=0.0,
        le=3_600.0,
        description="Vehicles that leave a section later than this after an advice began have heard it.",
    )
    knowing_count: int = Field(
        default=6, ge=1, le=1_000, description="So many vehicles that name a friction bound the advice from above."
    )
    likely_count: int = Field(
        default=20, ge=1, le=200, description="So many vehicles that send likelihoods bound it by the sum of these."
    )
    sure_count: int = Field(
        default=50,
        ge=1,
        le=10_000,
        description="Vehicles from which a lower bound may raise advice above the winter speed; above 1000: never.",
    )


class UdpSettings(Group):
    """UDP: frames as a V2X radio delivers them."""

    enabled: bool = Field(default=True, description="Whether the unit listens for frames over UDP.")
    host: Address = Field(
        default="127.0.0.1", description="Address to listen on; `0.0.0.0` opens the unit to its network."
    )
    port: Port = Field(default=4_740, description="UDP port.")
    cookies: bool = Field(
        default=True,
        description="Whether an arrival must show a cookie that was sent to its address before it is sent a map. "
        "Off only where addresses cannot be forged, such as behind a radio.",
    )
    signatures: SignatureMode = Field(
        default=SignatureMode.OFF,
        description="Signatures of messages over UDP: `off` (taken off unread), `optional` (a signed one must "
        "verify), `required`.",
    )
    broadcast_host: Address = Field(
        default="",
        description="Address that beacons and detections are sent to (unicast, broadcast or multicast); empty: none.",
    )
    broadcast_port: Port = Field(default=4_741, description="UDP port that beacons and detections are sent to.")
    beacon_period_s: float = Field(
        default=10.0, ge=0.0, le=3_600.0, description="How often each section is announced; 0 sends no beacons."
    )
    detections_per_s: float = Field(
        default=5.0,
        ge=0.1,
        le=1_000.0,
        description="Detections that are broadcast in a second, over all sections; more are refused as `busy`.",
    )
    receive_buffer_bytes: int = Field(
        # Some 800 datagrams. A vehicle repeats what was not answered within half a second, so what would wait longer is
        # better dropped: with 4 MB a unit worked for seconds on what was left of a flood.
        default=524_288,
        ge=65_536,
        description="Socket buffer asked for: what waits there for its turn. More bears a larger burst of vehicles, "
        "and makes the unit slower to recover from a flood.",
    )


class FrameSettings(Group):
    """Budgets of the exchange of frames; each bounds memory or work that a sender could cause."""

    exchange_limit_count: int = Field(
        default=4_096, ge=16, le=1_000_000, description="Passages whose frame budget is remembered at one time."
    )
    exchange_timeout_s: float = Field(
        default=3_600.0, ge=60.0, le=86_400.0, description="How long the frame budget of a passage is remembered."
    )
    refusals_per_s: float = Field(
        default=20.0,
        ge=0.0,
        le=10_000.0,
        description="Most rejections sent per second over UDP; all are counted in the metrics.",
    )
    frames_per_source_per_s: float = Field(
        default=200.0,
        ge=1.0,
        le=1_000_000.0,
        description="Frames a second that one address may send, and as many at once; more are refused as "
        "`rate_limited`. This machine's own addresses are not counted.",
    )
    free_sources: tuple[Address, ...] = Field(
        default=(),
        description="Addresses that are not counted either: a radio, or a gateway that hands on what many send.",
    )


class IngestSettings(Group):
    """How much work the unit takes on."""

    in_flight_limit_count: int = Field(
        default=256,
        ge=1,
        le=100_000,
        description="Passages in work at one time, over UDP and HTTP; more are refused as `busy`.",
    )
    passages_per_certificate_count: int = Field(
        default=2,
        ge=1,
        le=10_000,
        description="Passages of one section that one certificate may report in an hour; more are refused as "
        "`rate_limited`.",
    )


class SigningSettings(Group):
    """What the unit signs with and which authorities it believes; these files are read anew when they change."""

    credential_file: Path | None = Field(
        default=None,
        description="The unit's private key and its certificate (PEM), from `roadgrip-authority issue-unit`; left out, "
        "nothing is signed.",
    )
    authorities_folder: Path | None = Field(
        default=None, description="Folder of the public keys of authorities (`NAME.pem`) whose certificates count."
    )
    revocations_file: Path | None = Field(
        default=None, description="Signed list of revoked certificates, from `roadgrip-authority publish`."
    )
    replay_window_s: float = Field(
        default=REPLAY_WINDOW_S,
        ge=10.0,
        le=3_600.0,
        description="How far from now a signed message of a vehicle may have been sent, either way.",
    )


class UpdateSettings(Group):
    """Where new bundles come from, and what they have to stand before vehicles are answered by them."""

    folder: Path | None = Field(
        default=None,
        description="Shelf of bundles and of what is known about the repository; left out, `roadgrip-models` beside "
        "the database.",
    )
    source: str = Field(
        default="",
        description="Signed repository: a URL (`https://...`) or a folder; empty: only what `roadgrip-rsu update` is "
        "handed.",
    )
    trusted_root: Path | None = Field(
        default=None,
        description="The laboratory's `trusted-root.json`, brought here by hand; without it no release is taken.",
    )
    ring: str = Field(
        default="all", pattern=r"^[a-z][a-z0-9-]{0,31}$", description="The group of units that this one belongs to."
    )
    poll_period_s: float = Field(
        default=3_600.0, ge=1.0, le=30 * 86_400.0, description="How often the source is looked at."
    )
    shadow_count: int = Field(
        default=200, ge=0, le=100_000, description="Passages that a new bundle answers unheard before it is live."
    )
    probation_count: int = Field(
        default=200, ge=0, le=100_000, description="Passages that the one before is asked for comparison afterwards."
    )
    judged_from_count: int = Field(
        default=30, ge=1, le=1_000, description="Passages from which the limits below are held against it."
    )
    median_limit_ratio: float = Field(
        default=0.12, gt=0.0, le=2.0, description="Largest median difference of the two estimates, of ln mu."
    )
    spread_limit_ratio: float = Field(
        default=0.4, gt=0.0, le=5.0, description="What nine differences in ten must stay below, of ln mu."
    )
    share_limit_frac: float = Field(
        default=0.3,
        gt=0.0,
        le=1.0,
        description="By how much the shares of passages that name a friction, or count, may differ.",
    )
    latency_limit_s: float = Field(
        default=0.02, gt=0.0, le=1.0, description="What nineteen answers in twenty must take less than."
    )
    failures_limit_count: int = Field(
        default=0, ge=0, le=1_000, description="Passages that the new bundle may leave without an answer."
    )


class ControlSettings(Group):
    """How an operator on the machine speaks to the running unit: `roadgrip-rsu status`, `update`, `rollback`."""

    socket_path: Path | None = Field(
        default=None,
        description="Unix socket that only the unit's own account may use; left out, `control.sock` on the shelf of "
        "bundles.",
    )


class ClockSettings(Group):
    """Time."""

    speedup_ratio: float = Field(
        default=1.0,
        gt=0.0,
        le=10_000.0,
        description="Seconds per second. For demonstrations only; anything but 1 is logged loudly.",
    )


class LogSettings(Group):
    """Logs go to standard output."""

    level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="Least severity that is written."
    )
    lines_limit_per_s: float = Field(
        default=200.0, ge=1.0, description="Lines above this are dropped and counted; warnings and errors never."
    )
    style: Literal["json", "text"] = Field(
        default="json", description="`json`: one object a line; `text`: for a person's eyes."
    )
