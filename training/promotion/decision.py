"""What may be promoted: the order of the rings, what the gate said, and what was where before.

Everything here decides over plain values; `training.cli_promote` and `training.promotion.publication` bring them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from roadgrip.errors import RoadgripError
from roadgrip.ledger import Action, LedgerEntry
from roadgrip.release import DEFAULT_RINGS, Release, ReleaseError, ring_target
from training.laboratory import Laboratory

RINGS_NAME = "rings.json"


class PromotionError(RoadgripError):
    """A promotion that must not be; the message says what is missing."""


@dataclass(frozen=True, slots=True)
class Standing:
    """What is known of a bundle when somebody asks to promote it.

    Attributes:
        champion_id: What the last ring runs; None before the first bundle got there.
        released_ids: Every bundle that any ring runs or ran.
        been_in_rings: Where this bundle has been.
        verdict_passed: What the gate said of exactly this bundle against this champion; None if it said nothing.
    """

    champion_id: str | None
    released_ids: frozenset[str]
    been_in_rings: frozenset[str]
    verdict_passed: bool | None


def rings_of(lab: Laboratory) -> tuple[str, ...]:
    """Return the rings of a laboratory, who gets a bundle first and who after that: `rings.json`, or the default.

    Raises:
        ReleaseError: The file holds no list of different names.
    """
    path = lab.folder / RINGS_NAME
    if not path.is_file():
        return DEFAULT_RINGS
    return _rings_from(path)


def _rings_from(path: Path) -> tuple[str, ...]:
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ReleaseError(f"{path} is no JSON: {error}") from error
    if not isinstance(raw, list) or not raw or not all(isinstance(ring, str) for ring in raw):
        raise ReleaseError(f'{path} is no list of rings, such as ["canary", "all"]')
    for ring in raw:
        ring_target(ring)
    if len(set(raw)) != len(raw):
        raise ReleaseError(f"{path} names a ring twice")
    return tuple(raw)


def promotion_problem(
    bundle_id: str, ring: str, *, rings: Sequence[str], standing: Standing, overridden: bool
) -> str | None:
    """Return what speaks against a promotion and what would help; None if nothing does.

    A ring that does not exist cannot be overridden; everything else can, with a reason.

    Args:
        bundle_id: To promote.
        ring: Into.
        rings: All there are, in their order.
        standing: What is known of the bundle.
        overridden: Whether somebody gave a reason to do it nevertheless.
    """
    if ring not in rings:
        return f"there is no ring {ring!r}; they are, in their order, {', '.join(rings)}"
    if overridden:
        return None
    problems = []
    before = rings[rings.index(ring) - 1] if rings.index(ring) > 0 else None
    if before is not None and before not in standing.been_in_rings:
        problems.append(f"it was never in ring {before!r}: `--ring {before}` first")
    if gate_of(bundle_id, standing=standing, overridden=False) is None:
        against = f"the champion {standing.champion_id}" if standing.champion_id else "no champion"
        said = "failed it" if standing.verdict_passed is False else "said nothing of it"
        problems.append(f"the gate {said} against {against}: `roadgrip-train gate`")
    if not problems:
        return None
    return f"bundle {bundle_id} is not promoted: {'; '.join(problems)}; or give `--override REASON`, which is recorded"


def gate_of(bundle_id: str, *, standing: Standing, overridden: bool) -> str | None:
    """Return what a release says of the gate; None if it cannot be released without an override.

    Only the first bundle of all needs no verdict, since there was nothing to hold it against. An override of a gate
    that was passed (to skip a ring) leaves it passed.
    """
    if standing.verdict_passed:
        return "passed"
    if standing.verdict_passed is None and standing.champion_id is None and standing.released_ids <= {bundle_id}:
        return "none"
    return "overridden" if overridden else None


def standing_of(
    bundle_id: str,
    *,
    rings: Sequence[str],
    releases: Mapping[str, Release],
    ledger: Iterable[LedgerEntry],
    verdict_passed: bool | None,
) -> Standing:
    """Return what is known of a bundle.

    Args:
        bundle_id: To promote.
        rings: All there are, in their order.
        releases: What each ring runs.
        ledger: The laboratory's; promotions that were withdrawn before they were published do not count.
        verdict_passed: What the gate said of it against the champion.
    """
    champion = releases.get(rings[-1])
    been = {(release.bundle_id, ring) for ring, release in releases.items()}
    been |= {(entry.subject, entry.evidence.get("ring", "")) for entry in published_promotions(ledger)}
    return Standing(
        champion_id=None if champion is None else champion.bundle_id,
        released_ids=frozenset(released for released, _ in been),
        been_in_rings=frozenset(ring for released, ring in been if released == bundle_id),
        verdict_passed=verdict_passed,
    )


def published_promotions(ledger: Iterable[LedgerEntry]) -> list[LedgerEntry]:
    """Return the promotions of a ledger, oldest first, but for those that were withdrawn."""
    entries = list(ledger)
    withdrawn = {entry.evidence.get("withdrawn") for entry in entries if entry.action is Action.REFUSED}
    return [entry for entry in entries if entry.action is Action.PROMOTED and entry.entry_hash not in withdrawn]
