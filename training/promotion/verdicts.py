"""What the gate said of a bundle, found among the laboratory's verdicts."""

from __future__ import annotations

import hashlib

from roadgrip.ledger import Action
from training.gate.verdict import verdict_from_json
from training.laboratory import Laboratory
from training.promotion.decision import PromotionError
from training.promotion.publication import VerdictOnBundle

VERDICT_NAME = "verdict.json"


def verdicts_on(lab: Laboratory, bundle_id: str) -> dict[str | None, VerdictOnBundle]:
    """Return the newest verdict on a bundle against each champion that it was held against.

    The ledger tells the order and the digest: of two verdicts the one that was recorded last counts, and a file that
    the ledger does not know counts for nothing.

    Raises:
        PromotionError: A verdict is not the one that was recorded.
        RoadgripError: The ledger or a verdict cannot be read.
    """
    found: dict[str | None, VerdictOnBundle] = {}
    for entry in lab.ledger():
        if entry.action is not Action.JUDGED or entry.subject != bundle_id or "verdict" not in entry.evidence:
            continue
        digest = entry.evidence["verdict"]
        path = lab.verdicts_folder / digest / VERDICT_NAME
        if not path.is_file():
            continue
        content = path.read_bytes()
        if hashlib.sha256(content).hexdigest() != digest:
            raise PromotionError(f"{path} is not the verdict that the ledger names: judge the bundle again")
        verdict = verdict_from_json(content.decode())
        found[verdict.champion] = VerdictOnBundle(digest, verdict.challenger, verdict.champion, verdict.passed)
    return found
