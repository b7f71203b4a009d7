"""What units answer when they are asked how they are."""

from __future__ import annotations

from typing import Any


def section_said(section_id: str = "long-turn", **changes: Any) -> dict[str, Any]:
    return {
        "section_id": section_id,
        "passages_count": 34,
        "mu_low": 0.424,
        "mu_new": 0.531,
        "at_least": False,
        "newest_age_s": 12.0,
        "confidence": "provisional",
        "advised_mps": 16.6667,
        "advice_reason": "winter_speed_while_provisional",
        "drift": None,
    } | changes


def status_said(**changes: Any) -> dict[str, Any]:
    """A unit that is well."""
    return {
        "version": "0.1.0",
        "at": "2026-01-31T06:00:00+00:00",
        "ready": True,
        "conditions": [
            {"name": "model", "ok": True, "detail": "bundle 5f2c answers its golden vectors", "required": True},
            {"name": "store", "ok": True, "detail": "writes reach the disk", "required": True},
            {"name": "clock", "ok": True, "detail": "the wall clock is plausible and steady", "required": True},
            {"name": "window", "ok": True, "detail": "section long-turn: 34 vehicles", "required": False},
        ],
        "sections": [section_said()],
        "model": {
            "live_bundle_id": "5f2c77a0d1e8b934",
            "table_digests": ["3333"],
            "stage": "settled",
            "live": {"bundle_id": "5f2c77a0d1e8b934", "sequence_number": 7, "gate": "passed"},
            "previous": None,
            "candidate": None,
            "comparison": None,
            "wanted_count": 0,
            "ring": "all",
            "looked_unix_s": None,
            "last_refusal": None,
        },
        "passages": {
            "since_start_count": 5200,
            "outcomes": {"counted": 5000, "uncounted": 150, "rejected": 50},
            "refused_frac": {"stale_map": 0.01},
        },
        "traffic": {"per_s": {"counted": 0.5, "uncounted": 0.0166, "rejected": 0.0}, "refusals": []},
        "clock": {
            "ok": True,
            "detail": "the wall clock is plausible and steady",
            "synchronised": True,
            "max_error_s": 0.0042,
            "steps": {"steps_count": 0, "last_step_s": 0.0, "last_ago_s": None, "moved_s": 0.0012},
            "speedup_ratio": 1.0,
        },
        "disk": {
            "free_bytes": 6_100_000_000,
            "size_bytes": 7_700_000_000,
            "database_bytes": 12_582_912,
            "log_bytes": 4_300_000,
            "passages_count": 5150,
            "committed_ago_s": 2.0,
            "queued_count": 0,
            "queue_limit_count": 1024,
            "notes": [],
        },
        "process": {
            "process_number": 411,
            "up_s": 273_600.0,
            "resident_bytes": 100_663_296,
            "peak_bytes": 110_100_480,
            "files_count": 21,
            "memory_limit_bytes": 536_870_912,
        },
        "log_lines_dropped_count": 0,
    } | changes


def troubled() -> dict[str, Any]:
    """A unit with everything at once: a release in the shadow, a clock that was set, a disk that is full."""
    well = status_said()
    drift = {
        "rows_count": 900,
        "own_road": True,
        "drifted_count": 9,
        "own_rows_count": 300,
        "own_drifted_count": 4,
        "out_of_envelope_frac": 0.081,
        "estimates_outside_frac": 0.0,
        "alarms": ["features"],
        "worst": [{"feature": "speed_mean_mps", "psi_ratio": 0.4, "ks_frac": 0.3}],
    }
    return status_said(
        ready=False,
        conditions=[
            well["conditions"][0],
            {"name": "store", "ok": False, "detail": "writing: the disk is full", "required": True},
            {
                "name": "clock",
                "ok": False,
                "detail": "the wall clock stepped by 3600.0 s a moment ago",
                "required": True,
            },
            {"name": "window", "ok": False, "detail": "section gully: no vehicle in the window", "required": False},
        ],
        sections=[
            section_said(drift=drift),
            section_said(
                "the-hairpin-above-the-old-mill",
                passages_count=1204,
                at_least=True,
                confidence="recommended",
                advice_reason="friction_interval",
            ),
            section_said(
                "gully",
                passages_count=0,
                mu_low=None,
                mu_new=None,
                newest_age_s=None,
                confidence="insufficient",
                advice_reason="winter_speed_few_vehicles",
            ),
        ],
        model=well["model"]
        | {
            "stage": "shadow",
            "candidate": {"bundle_id": "9d01", "sequence_number": 8, "gate": "passed"},
            "previous": {"bundle_id": "factory", "sequence_number": 0, "gate": "none"},
            "comparison": {"passages_count": 12, "median_ratio": -0.013},
            "wanted_count": 200,
            "last_refusal": {"reason": "expired", "detail": "timestamp.json was of use until 2026-01-30"},
        },
        traffic={
            "per_s": {"counted": 0.0, "rejected": 11.25},
            "refusals": [
                {
                    "at": "2026-01-31T05:59:58+00:00",
                    "ago_s": 2.0,
                    "reason": "store_unavailable",
                    "section": "long-turn",
                    "via": "udp",
                    "detail": "writing: the disk is full",
                    "refused_count": 812,
                },
                {
                    "at": "2026-01-31T05:40:00+00:00",
                    "ago_s": 1200.0,
                    "reason": "bad_checksum",
                    "section": "",
                    "via": "udp",
                    "detail": "",
                    "refused_count": 1,
                },
            ],
        },
        clock=well["clock"]
        | {
            "ok": False,
            "detail": "the wall clock stepped by 3600.0 s a moment ago",
            "synchronised": False,
            "max_error_s": None,
            "steps": {"steps_count": 2, "last_step_s": 3600.0, "last_ago_s": 45.0, "moved_s": 3600.01},
        },
        disk=well["disk"]
        | {"free_bytes": 0, "committed_ago_s": None, "passages_count": None, "queued_count": 1024}
        | {"notes": ["the database was damaged (malformed); it lies in rsu.sqlite3.damaged-20260130 and a fresh one"]},
        log_lines_dropped_count=3,
    )
