"""What was read of a box: one frozen record for each check. None stands for what could not be told."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum


@dataclass(frozen=True, slots=True)
class SettingsSeen:
    """The settings.

    Attributes:
        source: The file, or that there is none.
        problem: Why they do not hold; empty if they do.
    """

    source: str
    problem: str = ""


@dataclass(frozen=True, slots=True)
class SectionsSeen:
    """The maps.

    Attributes:
        section_ids: Those that are served.
        problem: Why one cannot be used, or does not fit the frames; empty if all can.
    """

    section_ids: tuple[str, ...] = ()
    problem: str = ""


@dataclass(frozen=True, slots=True)
class BundleSeen:
    """The model a start would begin with, loaded and asked for its golden vectors.

    Attributes:
        bundle_id: Its bundle; empty without one.
        problem: Why there is none; empty if there is one.
        notes: Bundles of the shelf that had to be left behind.
    """

    bundle_id: str = ""
    problem: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RepositorySeen:
    """Where releases come from.

    Attributes:
        source: Its address; empty if none is configured.
        rooted: Whether a trusted root is configured.
        ring: The unit's ring.
        visited: Whether it was looked at.
        problem: Reason code and detail of what a look at it came to; empty if it was in order.
        reason: The reason code alone.
        expires_unix_s: When the first of its signatures expires.
    """

    source: str = ""
    rooted: bool = False
    ring: str = ""
    visited: bool = False
    problem: str = ""
    reason: str = ""
    expires_unix_s: float | None = None


@dataclass(frozen=True, slots=True)
class DatabaseSeen:
    """The database.

    Attributes:
        path: Its file.
        exists: Whether it is there.
        size_bytes: Of the file.
        log_bytes: Of its write-ahead log.
        others_may_read: Whether accounts other than owner and group may read it.
        writable: Whether this account may write the file and its folder.
        problems: What a whole reading of it found, and a revision that does not fit.
        newest_received_unix_s: When the newest passage was received; None without any.
        damaged: Names of damaged databases that lie beside it.
        account: Who is looking.
        owner: Whose file it is, or the folder's owner while there is no file.
        folder_owner: Whose folder it is in.
    """

    path: str
    exists: bool
    size_bytes: int = 0
    log_bytes: int = 0
    others_may_read: bool = False
    writable: bool = True
    problems: tuple[str, ...] = ()
    newest_received_unix_s: float | None = None
    damaged: tuple[str, ...] = ()
    account: str = ""
    owner: str = ""
    folder_owner: str = ""


class DiskKind(StrEnum):
    """What keeps the bytes."""

    CARD = "flash card"
    SOLID = "solid state disk"
    ROTATING = "rotating disk"
    MEMORY = "memory"
    NETWORK = "network"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class DiskSeen:
    """The file system that holds the database.

    Attributes:
        folder: Where it was looked at.
        kind: What keeps the bytes.
        file_system: Its type, such as ext4.
        read_only: Whether it is mounted so.
        free_bytes: Room left for this account.
        size_bytes: All of its room.
        sync_s: How long each of some small writes took until the disk said that it has them.
        problem: Why it could not be written to; empty if it could.
    """

    folder: str
    kind: DiskKind = DiskKind.UNKNOWN
    file_system: str = ""
    read_only: bool = False
    free_bytes: int | None = None
    size_bytes: int | None = None
    sync_s: tuple[float, ...] = ()
    problem: str = ""


@dataclass(frozen=True, slots=True)
class ClockSeen:
    """The clock.

    Attributes:
        unix_s: What it says.
        synchronised: Whether the kernel says that something keeps it right.
        max_error_s: How wrong it may be at most, if so.
        newest_stored_unix_s: The newest moment in the database, which lies in the past if the clock is right.
        battery_backed: Whether there is a clock that runs while the power is off.
        speedup_ratio: `clock.speedup_ratio`.
    """

    unix_s: float
    synchronised: bool | None = None
    max_error_s: float | None = None
    newest_stored_unix_s: float | None = None
    battery_backed: bool = False
    speedup_ratio: float = 1.0


@dataclass(frozen=True, slots=True)
class MemorySeen:
    """Memory of the box and of the unit.

    Attributes:
        total_bytes: Of the box.
        available_bytes: What a new process could have without swapping.
        swap_used_bytes: Swapped out right now.
        limit_bytes: Of the unit's control group; None without a limit.
        resident_bytes: What the running unit holds; None if none runs.
        killed_count: How often its control group ran out of memory.
    """

    total_bytes: int
    available_bytes: int
    swap_used_bytes: int = 0
    limit_bytes: int | None = None
    resident_bytes: int | None = None
    killed_count: int = 0


@dataclass(frozen=True, slots=True)
class ProcessorSeen:
    """The processor.

    Attributes:
        cores_count: Cores this account may use.
        load_count: Processes that wanted one, over five minutes.
        throttled_frac: Share of the periods in which the unit's control group had used up its quota; None without.
        slowed_count: How often a core slowed down for heat since the boot.
        hottest_c: Temperature of the hottest sensor; None without any.
    """

    cores_count: int
    load_count: float
    throttled_frac: float | None = None
    slowed_count: int = 0
    hottest_c: float | None = None


class PortState(StrEnum):
    """What becomes of somebody who wants to listen."""

    FREE = "free"
    TAKEN = "taken"
    NO_ADDRESS = "no such address"
    FORBIDDEN = "forbidden"


@dataclass(frozen=True, slots=True)
class PortSeen:
    """A port the settings name.

    Attributes:
        name: "http" or "udp".
        host: The address.
        port: Its number; 0 lets the machine choose.
        state: Whether it can be had.
        loopback: Whether only this machine reaches it.
        ours: Whether a unit of these settings runs.
        protected: Whether TLS or signatures keep strangers out.
    """

    name: str
    host: str
    port: int
    state: PortState
    loopback: bool
    ours: bool
    protected: bool = False


@dataclass(frozen=True, slots=True)
class UdpBufferSeen:
    """Room for datagrams that wait.

    Attributes:
        asked_bytes: `udp.receive_buffer_bytes`.
        granted_bytes: What the kernel gave to a socket that asked for it.
        drops_count: Datagrams the kernel dropped of the running unit's.
    """

    asked_bytes: int
    granted_bytes: int
    drops_count: int = 0


@dataclass(frozen=True, slots=True)
class TrustSeen:
    """Keys and certificates.

    Attributes:
        problem: Why the files cannot be used; empty if they can.
        signs: Whether the unit signs.
        believes: Whether signatures of vehicles are looked at.
        warnings: What is wrong with them.
        signature_ends_unix_s: When the unit's own certificate for signatures ends.
        tls: Whether HTTP is HTTPS.
        tls_ends_unix_s: When its certificate ends.
        exposed: Key files that others may read.
    """

    problem: str = ""
    signs: bool = False
    believes: bool = False
    warnings: tuple[str, ...] = ()
    signature_ends_unix_s: float | None = None
    tls: bool = False
    tls_ends_unix_s: float | None = None
    exposed: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class UnitSeen:
    """The running unit, as it answers on its control socket.

    Attributes:
        socket_path: The socket.
        runs: Whether one answers.
        problem: Why it cannot be asked, although something is there; empty if it can, or nothing is there.
        unmet: What keeps it from being ready, a line each.
        committed_ago_s: Since its last commit; None before the first and after a failure.
        lines_dropped_count: Log lines it dropped.
        others_may_order: Whether accounts other than its own may open the socket.
    """

    socket_path: str
    runs: bool
    problem: str = ""
    unmet: tuple[str, ...] = ()
    committed_ago_s: float | None = None
    lines_dropped_count: int = 0
    others_may_order: bool = False


@dataclass(frozen=True, slots=True)
class ServiceSeen:
    """The unit as systemd sees it.

    Attributes:
        managed: Whether systemd runs this box.
        properties: What `systemctl show` says, such as {"ActiveState": "active"}.
    """

    managed: bool
    properties: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LogSeen:
    """The journal.

    Attributes:
        journal_bytes: What it takes on the disk; None where it cannot be read.
        free_bytes: Room beside it.
    """

    journal_bytes: int | None
    free_bytes: int | None


@dataclass(frozen=True, slots=True)
class BackupSeen:
    """The backups.

    Attributes:
        folder: Where they were looked for.
        newest_unix_s: When the newest was written; None without any.
    """

    folder: str
    newest_unix_s: float | None
