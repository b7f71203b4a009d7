"""The composition root: settings in, a running unit out. The only module that knows all the others."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version as distribution_version
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING

import structlog

from roadgrip.belief import unit_claims
from roadgrip.errors import ConfigurationError, SectionError, StoreError, WireError
from roadgrip.exchange import ExchangeLedger
from roadgrip.features import TABLES
from roadgrip.records import MapOffer, Rejected
from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from roadgrip.signing import Signer
from roadgrip.trust import NamedFile, Trust, TrustFiles, trust_in, trust_warnings
from roadgrip.wire import encode_message
from rsu_app.adapters.clocks import AcceleratedClock, SystemClock
from rsu_app.cookies import Cookies
from rsu_app.domain.advisory import AdvisoryPolicy
from rsu_app.domain.change import ChangePolicy
from rsu_app.domain.interval import IntervalPolicy
from rsu_app.domain.probing import ProbingPolicy
from rsu_app.gateway import FrameGateway
from rsu_app.intake import PassageIntake
from rsu_app.moments import shown_moment
from rsu_app.observability import Metrics
from rsu_app.ports import Clock, PassageStore
from rsu_app.quota import PassageQuota
from rsu_app.rate import RateLimit
from rsu_app.rollout_wiring import load_model, loading_of, rollout_of, shelf_of, show_drift, show_rollout
from rsu_app.sender_guards import SenderGuards
from rsu_app.settings import Settings, passages_kept_s
from rsu_app.signatures import SignatureMode, Signatures
from rsu_app.usecases import FrictionPolicies, RoadSideUnit, SectionFriction, UnitLimits
from rsu_app.usecases.booting import boot
from rsu_app.usecases.rollout import Rollout
from rsu_app.vital_signs import VitalSigns, show_vital_signs

if TYPE_CHECKING:
    from rsu_app.adapters.http.door import Door
    from rsu_app.adapters.http.site import Broadcast, Site
    from rsu_app.adapters.http.stream import StreamDesk
    from rsu_app.adapters.udp.endpoint import FrameEndpoint

_log = structlog.get_logger("roadgrip")

FAR_AHEAD_UNIX_S = 2**33
"""Takes as many bytes to write as any moment that a unit will ever live to see."""


PASSAGE_LINES_FRAC = 0.8
"""Share of the log's budget that passages may use up: a fifth is left for what else there is to say."""


@dataclass(frozen=True, slots=True)
class Parts:
    """A unit and what serves it, put together but not started."""

    settings: Settings
    unit: RoadSideUnit
    store: PassageStore
    gateway: FrameGateway
    signatures: Signatures
    intake: PassageIntake
    rollout: Rollout
    streams: StreamDesk
    metrics: Metrics
    clock: Clock
    signs: VitalSigns


def build(settings: Settings, *, metrics: Metrics, sections: tuple[RoadSection, ...]) -> Parts:
    """Return the parts of a unit; opens and migrates the database, or goes on trying to.

    Args:
        settings: What the operator chose.
        metrics: Where everything is counted.
        sections: The maps, as `load_sections` gave them.

    Raises:
        RoadgripError: Something that was chosen cannot be.
    """
    from rsu_app.adapters.http.stream import StreamDesk
    from rsu_app.adapters.store import WriterLimits, open_or_standby

    trust = load_trust(settings)
    check_maps(sections, signer=trust.signer)
    shelf = shelf_of(settings)
    started = boot(shelf, loading_of(settings, metrics=metrics))
    for note in started.notes:
        _log.error("bundle_unusable", note=note)
    policy = _advisory_policy(settings)
    writing = WriterLimits(queue_count=settings.database.queue_limit_count)
    store = open_or_standby(
        settings.database.path,
        limits=writing,
        size_limit_bytes=settings.export.size_limit_bytes if settings.export.enabled else None,
    )
    clock = _clock(settings)
    unit = RoadSideUnit(
        sections=sections,
        store=store,
        model=started.model,
        clock=clock,
        policy=policy,
        section_policies={
            section.section_id: replace(policy, winter_speed_mps=chosen.winter_speed_mps)
            for section, chosen in zip(sections, settings.sections, strict=True)
            if chosen.winter_speed_mps is not None
        },
        friction_policies=_friction_policies(settings),
        limits=UnitLimits(
            window_s=settings.window.length_s,
            subscribers_count=settings.http.stream_clients_limit_count,
            retention_s=passages_kept_s(settings),
            rows_count=settings.database.rows_limit_count,
        ),
        model_absence="no model is loaded: " + "; ".join(started.notes),
    )
    rollout = rollout_of(settings, unit=unit, store=store, shelf=shelf, started=started, clock=clock, metrics=metrics)
    intake = PassageIntake(
        unit,
        metrics=metrics,
        in_flight_limit_count=settings.ingest.in_flight_limit_count,
        lines_per_s=PASSAGE_LINES_FRAC * settings.log.lines_limit_per_s,
    )
    signatures = Signatures(
        trust,
        modes={"udp": settings.udp.signatures, "http": settings.http.signatures},
        # What is signed is told by the machine's own clock, also when the unit's runs faster.
        unix_s=lambda: int(time.time()) if unit.clock_plausible else None,
        replay_window_s=settings.signing.replay_window_s,
    )
    gateway = FrameGateway(
        unit=unit,
        intake=intake,
        ledger=ExchangeLedger(
            limit_count=settings.frames.exchange_limit_count, timeout_s=settings.frames.exchange_timeout_s
        ),
        metrics=metrics,
        now_s=time.monotonic,  # budgets guard this machine, so they go by its own time also when the unit's runs faster
        random_bytes=secrets.token_bytes,
        refusals_per_s=settings.frames.refusals_per_s,
        signatures=signatures,
        guards=SenderGuards(
            cookies=Cookies(secrets.token_bytes(32)) if settings.udp.cookies else None,
            frames_per_s=settings.frames.frames_per_source_per_s,
            free_hosts=settings.frames.free_sources,
            passages_quota=PassageQuota(settings.ingest.passages_per_certificate_count),
        ),
    )
    return Parts(
        settings=settings,
        unit=unit,
        store=store,
        gateway=gateway,
        signatures=signatures,
        intake=intake,
        rollout=rollout,
        streams=StreamDesk(metrics),
        metrics=metrics,
        clock=clock,
        signs=VitalSigns(clock, metrics),
    )


def renew_trust(parts: Parts) -> None:
    """Go by the credential, the authorities and the list of revoked certificates as their files are now.

    Files that cannot be used change nothing: a unit with last week's list is better than one without any.
    """
    signatures = parts.signatures
    try:
        trust = load_trust(parts.settings, previous=signatures.trust)
    except ConfigurationError as error:
        _log.error("trust_not_renewed", error=str(error))
        return
    if trust is signatures.trust:
        return
    signatures.trust = trust
    _log.info("trust_renewed")
    if parts.unit.clock_plausible:
        for warning in trust_warnings(trust, now_unix_s=time.time(), section_ids=parts.unit.section_ids):
            _log.warning("trust", warning=warning)


def open_door(settings: Settings) -> Door:
    """Return who gets in over HTTP, and by which certificate.

    Raises:
        ConfigurationError: A file of tokens, certificates or keys cannot be used.
    """
    from rsu_app.adapters.http.access import OperatorAccess
    from rsu_app.adapters.http.door import Door

    http = settings.http
    tls = None
    if http.tls_certificate_file is not None and http.tls_key_file is not None:
        # 9 MB that a unit without a certificate does not carry.
        from rsu_app.adapters.http.tls import ServerTls, TlsFiles

        tls = ServerTls(TlsFiles(http.tls_certificate_file, http.tls_key_file, http.client_authorities_file))
    return Door(OperatorAccess(settings.operators.tokens_file), tls)


def site_of_parts(parts: Parts, *, endpoint: FrameEndpoint | None, door: Door) -> Site:
    """Return the unit as HTTP sees it."""
    from rsu_app.adapters.http.site import Site

    settings = parts.settings
    detections = RateLimit(settings.udp.detections_per_s)
    return Site(
        unit=parts.unit,
        intake=parts.intake,
        gateway=parts.gateway,
        broadcast=_broadcaster(parts, endpoint),
        detection_allowed=lambda: detections.take(now_s=time.monotonic()),
        observe=lambda: _observe_all(parts, door, endpoint),
        streams=parts.streams,
        metrics=parts.metrics,
        version=software_version(),
        signatures_required=settings.http.signatures is SignatureMode.REQUIRED,
        body_limit_bytes=settings.http.body_limit_bytes,
        stream_heartbeat_s=settings.http.stream_heartbeat_s,
        access=door.access,
        checks=lambda: door.checks(now_unix_s=parts.clock.unix_s()),
    )


async def _observe_all(parts: Parts, door: Door, endpoint: FrameEndpoint | None) -> None:
    await observe(parts)
    if endpoint is not None:
        endpoint.observe()
    now_unix_s = parts.clock.unix_s()
    for check in door.checks(now_unix_s=now_unix_s):
        parts.metrics.condition_ok.labels(check.name).set(check.ok)
    if door.tls is not None:
        parts.metrics.certificate_days.set(door.tls.days_left(now_unix_s=now_unix_s))


async def observe(parts: Parts) -> None:
    """Bring the gauges up to date."""
    from rsu_app.adapters.store import moved_aside

    metrics, unit = parts.metrics, parts.unit
    for section_id in unit.section_ids:
        friction, advisory = unit.current_friction(section_id), unit.current_advisory(section_id)
        known = friction.interval if isinstance(friction, SectionFriction) else None
        # A gauge without a value is NaN: zero would be black ice.
        metrics.mu_low.labels(section_id).set(known.mu_low if known else nan)
        metrics.mu_new.labels(section_id).set(known.mu_new if known else nan)
        metrics.median_mu.labels(section_id).set(known.median_mu if known else nan)
        metrics.at_least.labels(section_id).set(friction.at_least if isinstance(friction, SectionFriction) else nan)
        metrics.window_passages.labels(section_id).set(known.passages_count if known else 0)
        if not isinstance(advisory, Rejected):
            metrics.advisory_speed.labels(section_id).set(advisory.speed_mps)
    parts.gateway.observe()
    show_rollout(parts.rollout.status, unit=unit, metrics=metrics)
    show_drift(unit, metrics=metrics)
    try:
        counts = await parts.store.counts()
    except StoreError as error:
        _log.warning("store_unreadable", error=str(error))
    else:
        metrics.store_queue.set(counts.queued_count)
        metrics.store_passages.set(counts.passages_count)
        metrics.store_size.set(counts.database_bytes)
    readiness = await unit.readiness()
    metrics.ready.set(readiness.ready)
    metrics.in_flight.set(parts.intake.in_flight_count)
    for name, ok in readiness.conditions().items():
        metrics.condition_ok.labels(name).set(ok)
    show_vital_signs(
        parts.signs,
        parts.store.pulse,
        folder=parts.settings.database.path.parent,
        damaged_count=len(moved_aside(parts.settings.database.path)),
        metrics=metrics,
    )


def load_sections(settings: Settings) -> tuple[RoadSection, ...]:
    """Return the sections in the order of the settings.

    Raises:
        ConfigurationError: A file cannot be read or holds no section, or a section is given twice.
    """
    sections = tuple(_section(chosen.file) for chosen in settings.sections)
    ids = [section.section_id for section in sections]
    if twice := sorted({section_id for section_id in ids if ids.count(section_id) > 1}):
        raise ConfigurationError(f"sections given twice: {', '.join(twice)}")
    return sections


def check_maps(sections: tuple[RoadSection, ...], *, signer: Signer | None) -> None:
    """Do nothing if each map fits the frames that vehicles get it in.

    Raises:
        ConfigurationError: One does not; known at the start, and not by the vehicles that ask for it.
    """
    for section in sections:
        try:
            offer = MapOffer(section, tuple(TABLES))
            claims = unit_claims(
                offer, section_id=section.section_id, map_version=section.version, issued_unix_s=FAR_AHEAD_UNIX_S
            )
            encode_message(offer, signer=signer, claims=claims)
        except WireError as error:
            raise ConfigurationError(
                f"section {section.section_id}: {error.detail}; make it shorter or its nodes and anchors fewer"
            ) from error


def load_trust(settings: Settings, *, previous: Trust | None = None) -> Trust:
    """Return what the unit signs with and whom it believes, as its files say now.

    Args:
        settings: Where they are.
        previous: What the unit has gone by so far; returned itself if nothing has changed.

    Raises:
        ConfigurationError: A file cannot be read or holds something else. A running unit stays with the previous.
    """
    signing = settings.signing
    folder = signing.authorities_folder
    if folder is not None and not folder.is_dir():
        raise ConfigurationError(f"signing.authorities_folder: {folder} is no folder")
    credential, revocations = signing.credential_file, signing.revocations_file
    files = TrustFiles(
        credentials=() if credential is None else (_file_of(credential),),
        authorities=() if folder is None else tuple(_file_of(path) for path in sorted(folder.glob("*.pem"))),
        revocations=None if revocations is None else _file_of(revocations),
    )
    asking = [
        name
        for name, mode in (("udp", settings.udp.signatures), ("http", settings.http.signatures))
        if mode is not SignatureMode.OFF
    ]
    if asking and not files.authorities:
        raise ConfigurationError(
            f"{asking[0]}.signatures needs the public key of an authority (NAME.pem) in signing.authorities_folder"
        )
    return trust_in(files, previous=previous)


def check_settings(settings: Settings) -> list[str]:
    """Return what the settings lead to, a line each.

    Raises:
        RoadgripError: Something that was chosen cannot be.
    """
    sections = load_sections(settings)
    trust = load_trust(settings)
    check_maps(sections, signer=trust.signer)
    if settings.database.path.is_dir():
        raise ConfigurationError(f"database.path: {settings.database.path} is a folder; name a file in it")
    lines = [
        f"section {s.section_id}: {s.length_m:.0f} m, map {s.version}, bank {s.bank_origin.value}" for s in sections
    ]
    manifest = load_model(settings).manifest
    lines.append(f"bundle {manifest.bundle_id}: {manifest.name}")
    for model in manifest.models:
        low_mu, high_mu = model.mu_range
        error = "no expected error" if model.conformal is None else "with its expected error"
        lines.append(f"feature table {model.table_digest}: friction {low_mu:.2f} to {high_mu:.2f}, {error}")
    lines += _trust_lines(settings, trust, section_ids=[section.section_id for section in sections])
    lines += _door_lines(settings)
    problems = check_database(settings.database.path)
    lines.append(f"database {settings.database.path}: " + ("; ".join(problems) or "sound"))
    return lines


def _door_lines(settings: Settings) -> list[str]:
    door = open_door(settings)
    if settings.operators.tokens_file is None:
        words = "metrics, health and detections only for clients on this machine"
    else:
        words = f"metrics, health and detections with a token of {settings.operators.tokens_file}"
    lines = [f"{door.url_scheme} on {settings.http.host} port {settings.http.port}: {words}"]
    return lines + [check.detail for check in door.checks(now_unix_s=time.time())]


def upgrade_database(path: Path) -> str:
    """Return the revision of the database after bringing it up to date; makes it if missing.

    Raises:
        StoreError: It cannot be.
    """
    from rsu_app.adapters.store import upgrade

    return str(upgrade(path).current)


def check_database(path: Path) -> list[str]:
    """Return what is wrong with the database; nothing if it is whole and of this software's schema."""
    from rsu_app.adapters.store import check, integrity_problems

    if not path.exists():
        return ["it does not exist yet; `roadgrip-rsu db upgrade` or `serve` make it"]
    try:
        problems = integrity_problems(path)
        state = check(path)
    except StoreError as error:
        return [str(error)]
    if not state.up_to_date:
        problems.append(f"revision {state.current}, this software needs {state.expected}")
    return problems


def software_version() -> str:
    """Return the version of the installed distribution."""
    return distribution_version("roadgrip")


def _clock(settings: Settings) -> Clock:
    ratio = settings.clock.speedup_ratio
    if ratio == 1.0:
        return SystemClock()
    _log.warning(
        "clock_accelerated",
        speedup_ratio=ratio,
        warning="FOR DEMONSTRATIONS ONLY: this unit's hour is not an hour, and its stored times are invented",
    )
    from rsu_app.adapters.store import newest_received_unix_s

    return AcceleratedClock(ratio, not_before_unix_s=newest_received_unix_s(settings.database.path))


def _advisory_policy(settings: Settings) -> AdvisoryPolicy:
    return AdvisoryPolicy(**settings.advisory.model_dump())


def _friction_policies(settings: Settings) -> FrictionPolicies:
    window, change = settings.window, settings.change_detection
    return FrictionPolicies(
        interval=IntervalPolicy(**window.model_dump(exclude={"length_s"})),
        probing=ProbingPolicy(**settings.probing.model_dump()),
        change=ChangePolicy(**change.model_dump(exclude={"enabled"})) if change.enabled else None,
    )


def _section(file: str) -> RoadSection:
    try:
        return read_section(file)
    except SectionError as error:
        raise ConfigurationError(str(error)) from error


def _trust_lines(settings: Settings, trust: Trust, *, section_ids: list[str]) -> list[str]:
    if trust.signer is None:
        lines = ["signs nothing"]
    else:
        certificate = trust.signer.certificate
        sections = ", ".join(certificate.section_ids) or "all sections"
        until = shown_moment(certificate.valid_until_unix_s)
        lines = [f"signs by certificate {certificate.certificate_id.hex()} for {sections}, until {until}"]
    authorities = () if trust.verifier is None else trust.verifier.authorities
    lines.append(
        f"trusts {len(authorities)} authorities; signatures over UDP {settings.udp.signatures.value}, over HTTP "
        f"{settings.http.signatures.value}"
    )
    if trust.revocations is not None:
        count, due = len(trust.revocations.certificate_ids), shown_moment(trust.revocations.due_unix_s)
        lines.append(f"{count} certificates are revoked; the next list is due {due}")
    lines += [f"warning: {told}" for told in trust_warnings(trust, now_unix_s=time.time(), section_ids=section_ids)]
    return lines


def _file_of(path: Path) -> NamedFile:
    try:
        return NamedFile(str(path), path.read_bytes())
    except OSError as error:
        raise ConfigurationError(f"cannot read {path}: {error.strerror}") from error


def _broadcaster(parts: Parts, endpoint: FrameEndpoint | None) -> Callable[[str], Broadcast] | None:
    from rsu_app.adapters.http.site import Broadcast

    if endpoint is None or not parts.settings.udp.broadcast_host:
        return None

    def broadcast(section_id: str) -> Broadcast:
        messages = parts.gateway.guidance(section_id)
        return Broadcast(frames_count=sum(len(m.frames) for m in messages), bytes_count=endpoint.broadcast(messages))

    return broadcast
