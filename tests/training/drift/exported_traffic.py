"""Made-up exports whose features follow the friction, for tests of drift."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roadgrip.bundle import BundleManifest
from roadgrip.features import NEWEST_TABLE
from roadgrip.passage_export import ExportedPassage, ExportHead, head_to_json, passage_to_json
from roadgrip.records import NotCounted
from tests.bundles import MODEL_NAME, linear_onnx, make_model, manifest_of
from training.data.exported_passages import Export
from training.drift.reference import learn_references

DAY_S = 86_400.0
START_UNIX_S = 1_700_000_000.0
WIDTH = len(NEWEST_TABLE.kinematic)
HOURS_COUNT = 16
"""Of traffic a day; each with a friction of its own."""
HOURLY_COUNT = 4
DAILY_COUNT = HOURS_COUNT * HOURLY_COUNT
MODEL = linear_onnx()


def rows_of(mu, rng, *, changed=False):
    """Return features that friction moves, half of them otherwise when traffic has changed. (n, kinematic)"""
    rows = rng.normal(size=(len(mu), WIDTH)) + 4.0 * mu[:, None]
    if changed:
        rows[:, : WIDTH // 2] += 1.5
    return rows.astype(np.float32)


def watched_manifest(*, with_references: bool = True) -> BundleManifest:
    """Return the manifest of a bundle that says how its training was distributed."""
    rng = np.random.default_rng(0)
    mu = rng.uniform(0.2, 0.7, 2000)
    features = np.column_stack([rows_of(mu, rng), np.zeros((2000, len(NEWEST_TABLE) - WIDTH))])
    references = learn_references(features, mu, ["bend"] * 2000, known_sections=["bend"])
    model = replace(make_model(), references=references if with_references else ())
    return manifest_of([model], {MODEL_NAME: MODEL})


def passages_of(
    manifest: BundleManifest,
    days: Sequence[float],
    *,
    seed: int,
    section_id: str = "bend",
    changed_from_day: float = np.inf,
    outside_frac: float = 0.0,
    shadow_ratio: float | None = None,
) -> list[ExportedPassage]:
    """Return the passages of some days; weather changes every hour."""
    rng = np.random.default_rng(seed)
    passages: list[ExportedPassage] = []
    for day in days:
        for hour in range(HOURS_COUNT):
            mu = rng.choice([0.25, 0.4, 0.6]) * rng.uniform(0.97, 1.0, HOURLY_COUNT)
            changed = day >= changed_from_day
            for row, one in zip(rows_of(mu, rng, changed=changed), mu.tolist(), strict=True):
                outside = rng.random() < outside_frac and changed
                passages.append(
                    ExportedPassage(
                        section_id=section_id,
                        map_version="v1",
                        table_digest=NEWEST_TABLE.digest,
                        values=row,
                        duration_s=20.0,
                        quality=0,
                        left_unix_s=START_UNIX_S + DAY_S * day + 3600.0 * hour + 10.0 * len(passages) % 3600.0,
                        bundle_id=manifest.bundle_id,
                        mu=one,
                        flags=NotCounted.OUT_OF_ENVELOPE.value if outside else 0,
                        expected_error_ratio=None,
                        mu_low=None,
                        at_least=False,
                        shadow_bundle_id=None if shadow_ratio is None else "shadow",
                        shadow_mu=None if shadow_ratio is None else one * shadow_ratio,
                    )
                )
    return passages


def head_of(manifest: BundleManifest, *, unit: str) -> ExportHead:
    return ExportHead(
        unit=unit,
        exported_unix_s=START_UNIX_S,
        since_unix_s=START_UNIX_S,
        until_unix_s=START_UNIX_S,
        sections_json={},
        bundle_id=manifest.bundle_id,
        ledger_hash="",
        software="0",
    )


def export_of(manifest: BundleManifest, passages: Sequence[ExportedPassage], *, unit: str = "unit-1") -> Export:
    """Return an export as if it had been read."""
    head = head_of(manifest, unit=unit)
    digest = hashlib.sha256(unit.encode()).hexdigest()[:16]
    return Export(f"{unit}.jsonl", digest, head, dict(enumerate(passages, start=2)), ())


def text_of(export: Export) -> str:
    """Return the file of an export."""
    lines = [head_to_json(export.head), *map(passage_to_json, export.passages.values())]
    return "\n".join(lines) + "\n"
