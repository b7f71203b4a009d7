"""Judgements on the unit: settings, maps, model, database, ports, keys, and what a running one says of itself."""

from __future__ import annotations

from rsu_app.doctor.findings import Finding, failed, fine, warned
from rsu_app.doctor.seen import (
    BundleSeen,
    DatabaseSeen,
    PortSeen,
    PortState,
    RepositorySeen,
    SectionsSeen,
    SettingsSeen,
    TrustSeen,
    UnitSeen,
)
from rsu_app.moments import shown_moment
from rsu_app.words import duration_words, size_words

DAY_S = 86_400.0
ENDS_SOON_S = 30 * DAY_S
LOG_WARN_BYTES = 64 * 1024 * 1024
"""Four times what the write-ahead log shrinks back to: somebody keeps an old reading open."""
SILENCE_WARN_S = DAY_S
COMMIT_WARN_S = 3_600.0
_REPOSITORY_REMEDIES = {
    "clock": "set the clock",
    "expired": "roadgrip-train refresh, in the laboratory; or a fresher stick",
    "unreachable": "look at the network: curl -I the source",
    "no_release": "roadgrip-train promote for this ring, or mend updates.ring",
}
OTHER_REPOSITORY_REMEDY = "docs/operators.md tells what each reason of a refusal means"


def settings_finding(settings: SettingsSeen) -> Finding:
    """Return whether the settings hold together."""
    if settings.problem:
        return failed("settings", settings.problem, "mend the setting that is named; roadgrip-rsu config check")
    return fine("settings", settings.source)


def sections_finding(sections: SectionsSeen) -> Finding:
    """Return whether every map can be used and sent."""
    if sections.problem:
        return failed("sections", sections.problem, "roadgrip-rsu section check; sections in the settings")
    return fine("sections", ", ".join(sections.section_ids))


def bundle_finding(bundle: BundleSeen) -> Finding:
    """Return whether there is a model that answers as it did in the laboratory."""
    if bundle.problem:
        return failed(
            "bundle", bundle.problem, "roadgrip-rsu update, or model.bundle_path, or install the package anew"
        )
    if bundle.notes:
        seen = f"{bundle.bundle_id}; {'; '.join(bundle.notes)}"
        return warned("bundle", seen, "roadgrip-rsu update brings a whole one")
    return fine("bundle", f"{bundle.bundle_id} answers its golden vectors")


def repository_finding(repository: RepositorySeen, *, now_unix_s: float) -> Finding:
    """Return whether releases would arrive.

    Args:
        repository: Where from.
        now_unix_s: By the wall clock.
    """
    name = "releases"
    if not repository.source:
        return fine(name, "no source is configured: bundles come by hand")
    if not repository.rooted:
        return warned(name, f"{repository.source}: nobody is trusted", "updates.trusted_root; docs/operators.md")
    seen = f"{repository.source}, ring {repository.ring}"
    if not repository.visited:
        return fine(name, f"{seen}; not looked at")
    if repository.problem:
        remedy = _REPOSITORY_REMEDIES.get(repository.reason, OTHER_REPOSITORY_REMEDY)
        return warned(name, f"{seen}: {repository.problem}", remedy)
    if repository.expires_unix_s is not None:
        seen += f", signed until {shown_moment(repository.expires_unix_s)}"
        if repository.expires_unix_s - now_unix_s < 7 * DAY_S:
            return warned(name, seen, _REPOSITORY_REMEDIES["expired"])
    return fine(name, seen)


def database_finding(database: DatabaseSeen) -> Finding:
    """Return whether the database is whole, of this software, and this account's."""
    name, path = "database", database.path
    if not database.writable:
        return failed(
            name,
            f"{path} of {database.owner or 'nobody'} cannot be written by {database.account}",
            f"give the command as the unit's account (sudo -u roadgrip), or chown it: chown -R roadgrip {path}*",
        )
    if database.owner != database.folder_owner:
        return failed(
            name,
            f"{path} belongs to {database.owner}, and its folder to {database.folder_owner}",
            f"somebody ran the unit by hand: chown {database.folder_owner} {path}*",
        )
    if not database.exists:
        return fine(name, f"{path} does not exist yet; the unit makes it")
    seen = f"{path}, {size_words(database.size_bytes)}, log {size_words(database.log_bytes)}"
    if database.problems:
        return failed(
            name,
            f"{path}: {'; '.join(database.problems)}",
            "start the unit anew: it moves a damaged one aside and brings an old one up to date; roadgrip-rsu restore",
        )
    if database.damaged:
        return warned(
            name,
            f"{seen}; damaged ones lie beside it: {', '.join(database.damaged)}",
            "copy them away for whoever wants to look, then delete them; test the disk",
        )
    if database.log_bytes > LOG_WARN_BYTES:
        return warned(name, seen, "a reader keeps the log from being written back: lsof on the file; restart the unit")
    if database.others_may_read:
        return warned(name, f"{seen}; every account may read it", f"chmod o-rwx {path}*")
    return fine(name, seen)


def traffic_finding(database: DatabaseSeen, *, now_unix_s: float) -> Finding:
    """Return whether vehicles have been heard of late.

    Args:
        database: What is stored.
        now_unix_s: By the wall clock.
    """
    newest_unix_s = database.newest_received_unix_s
    remedy = "is the road open, the radio up, udp.host reachable? roadgrip-rsu status shows what is refused"
    if newest_unix_s is None:
        return warned("passages", "none is stored", remedy)
    age_s = now_unix_s - newest_unix_s
    seen = f"the newest came {duration_words(age_s)} ago"
    return warned("passages", seen, remedy) if age_s > SILENCE_WARN_S else fine("passages", seen)


def port_finding(port: PortSeen) -> Finding:
    """Return whether a port can be had, or is held by this very unit, and who reaches it."""
    name, seen = f"{port.name} port", f"{port.host}:{port.port}"
    settings = f"{port.name}.host and {port.name}.port"
    if port.state is PortState.NO_ADDRESS:
        return failed(name, f"{port.host} is no address of this machine", f"{settings}; ip addr")
    if port.state is PortState.FORBIDDEN:
        return failed(name, f"{seen} may not be listened on by this account", f"{settings}: above 1023")
    # Whoever runs with port 0 has one that nobody can know from the settings.
    if port.ours and port.state is PortState.FREE and port.port:
        return failed(name, f"a unit runs, and nobody listens on {seen}", "it has older settings: start it anew")
    if not port.ours and port.state is PortState.TAKEN:
        return failed(name, f"{seen} is held by another program", f"ss -lunpt | grep :{port.port}; or {settings}")
    held = "held by the unit" if port.state is PortState.TAKEN else "free"
    if port.name == "udp" and port.loopback:
        return warned(
            name,
            f"{seen}, {held}: only this machine reaches it",
            "udp.host: the address the radio delivers frames to",
        )
    if not port.loopback and not port.protected:
        return warned(
            name,
            f"{seen}, {held}: strangers reach it, and nothing is asked of them",
            "docs/security.md: certificates and signatures; or a network that only the radio reaches"
            if port.name == "udp"
            else "http.tls_certificate_file, or a proxy in front; docs/security.md",
        )
    return fine(name, f"{seen}, {held}" + (", reached from this machine only" if port.loopback else ""))


def trust_finding(trust: TrustSeen, *, now_unix_s: float) -> Finding:
    """Return whether keys and certificates can be used, and for how long.

    Args:
        trust: Keys and certificates.
        now_unix_s: By the wall clock.
    """
    name = "keys"
    if trust.problem:
        return failed(name, trust.problem, "the setting that is named; docs/security.md")
    if trust.exposed:
        return failed(
            name,
            f"others may read {', '.join(trust.exposed)}",
            f"chmod 640 {' '.join(trust.exposed)}, and have the keys made anew",
        )
    seen = "; ".join(
        (
            "signs" if trust.signs else "signs nothing",
            "looks at signatures" if trust.believes else "looks at no signatures",
            "HTTPS" if trust.tls else "plain HTTP",
        )
    )
    for what, ends_unix_s in (
        ("the certificate for signatures", trust.signature_ends_unix_s),
        ("the certificate of HTTPS", trust.tls_ends_unix_s),
    ):
        if ends_unix_s is None:
            continue
        if ends_unix_s < now_unix_s:
            return failed(name, f"{what} ended {shown_moment(ends_unix_s)}", "issue a new one; docs/security.md")
        if ends_unix_s - now_unix_s < ENDS_SOON_S:
            return warned(name, f"{what} ends {shown_moment(ends_unix_s)}", "issue a new one; docs/security.md")
    if trust.warnings:
        return warned(name, "; ".join(trust.warnings), "docs/security.md")
    return fine(name, seen)


def unit_findings(unit: UnitSeen) -> tuple[Finding, ...]:
    """Return how the running unit is by its own account, and the socket on which it was asked."""
    if unit.problem:
        return (
            failed(
                "unit",
                unit.problem,
                "give the command as the unit's account: sudo -u roadgrip roadgrip-rsu doctor; or start it anew",
            ),
        )
    if not unit.runs:
        return (
            warned(
                "unit",
                f"none runs (nothing answers at {unit.socket_path})",
                "systemctl start roadgrip-rsu, or roadgrip-rsu serve",
            ),
        )
    found = [
        failed("unit", why, "the finding on the same thing says what mends it; roadgrip-rsu status")
        for why in unit.unmet
    ] or [fine("unit", "runs and is ready")]
    if unit.others_may_order:
        found.append(
            failed("control socket", f"other accounts may open {unit.socket_path}", f"chmod 600 {unit.socket_path}")
        )
    ago_s = unit.committed_ago_s
    if ago_s is None:
        found.append(warned("commits", "none yet, or the last one failed", "the findings on disk and database"))
    elif ago_s > COMMIT_WARN_S:
        found.append(fine("commits", f"the last one {duration_words(ago_s)} ago; nothing came since"))
    else:
        found.append(fine("commits", f"the last one {duration_words(ago_s)} ago"))
    return tuple(found)
