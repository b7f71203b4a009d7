"""Makes `roadgrip.dashboard.json`, the Grafana dashboard: `python -m deploy.monitoring.dashboard`.

The table below is what one edits; a test holds the file to it, and every metric in it to what a unit exposes.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

DASHBOARD_FILE = Path(__file__).with_name("roadgrip.dashboard.json")
COLUMNS_COUNT = 24
SOURCE = {"type": "prometheus", "uid": "${source}"}
UNIT = 'instance=~"$unit"'
SECTION = f'{UNIT},section=~"$section"'
INGEST = "roadgrip_ingest_duration_seconds"
INFERENCE = "roadgrip_inference_duration_seconds"


@dataclass(frozen=True, slots=True)
class Panel:
    """One picture.

    Attributes:
        title: What it shows.
        unit: Grafana's name of the unit.
        series: Pairs of a query and the legend of what it gives.
        steps: Values from which on it is shown in another colour; the first colour holds below all of them.
        kind: Grafana's kind of panel.
        width_count: Columns of 24.
        note: What one should know to read it.
    """

    title: str
    unit: str
    series: tuple[tuple[str, str], ...]
    steps: tuple[tuple[float, str], ...] = ()
    kind: str = "timeseries"
    width_count: int = 8
    note: str = ""


ROWS: tuple[tuple[str, tuple[Panel, ...]], ...] = (
    (
        "Now",
        (
            Panel(
                "Ready",
                "bool_yes_no",
                ((f"min(roadgrip_ready{{{UNIT}}})", "all units"),),
                ((0.0, "red"), (1.0, "green")),
                "stat",
                4,
            ),
            Panel(
                "Conditions",
                "bool_yes_no",
                ((f"min by (condition) (roadgrip_condition_ok{{{UNIT}}})", "{{condition}}"),),
                ((0.0, "red"), (1.0, "green")),
                "stat",
                8,
                "The window may be empty on a quiet road; the unit is ready all the same.",
            ),
            Panel(
                "Passages in the window",
                "short",
                ((f"sum by (section) (roadgrip_window_passages{{{SECTION}}})", "{{section}}"),),
                ((0.0, "red"), (10.0, "yellow"), (50.0, "green")),
                "stat",
                6,
            ),
            Panel(
                "Advised speed",
                "velocitykmh",
                ((f"roadgrip_advisory_speed_mps{{{SECTION}}} * 3.6", "{{section}}"),),
                (),
                "stat",
                6,
            ),
        ),
    ),
    (
        "Sections",
        (
            Panel(
                "Friction interval",
                "none",
                (
                    (f"roadgrip_interval_mu_new{{{SECTION}}}", "{{section}} new tyre"),
                    (f"roadgrip_interval_median_mu{{{SECTION}}}", "{{section}} median"),
                    (f"roadgrip_interval_mu_low{{{SECTION}}}", "{{section}} worn tyre"),
                ),
                ((0.0, "red"), (0.3, "orange"), (0.5, "yellow"), (0.7, "green")),
                width_count=12,
                note="Below 0.3 is ice, below 0.5 snow; a gap means that nobody has passed.",
            ),
            Panel(
                "Advised speed",
                "velocitykmh",
                ((f"roadgrip_advisory_speed_mps{{{SECTION}}} * 3.6", "{{section}}"),),
                width_count=8,
            ),
            Panel(
                "Few vehicles name a friction",
                "bool_yes_no",
                ((f"roadgrip_interval_at_least{{{SECTION}}}", "{{section}}"),),
                width_count=4,
                note="No fault where all drive slowly: nobody feels the limit there.",
            ),
        ),
    ),
    (
        "Traffic",
        (
            Panel(
                "Passages by outcome",
                "reqps",
                ((f"sum by (outcome) (rate(roadgrip_passages_total{{{SECTION}}}[5m]))", "{{outcome}}"),),
            ),
            Panel(
                "Passages refused, by reason",
                "reqps",
                (
                    (
                        f'sum by (reason) (rate(roadgrip_passages_total{{{SECTION},outcome="rejected"}}[5m]))',
                        "{{reason}}",
                    ),
                ),
                ((0.0, "green"), (0.02, "yellow"), (1.0, "red")),
            ),
            Panel(
                "Frames",
                "pps",
                (
                    (f"sum by (via) (rate(roadgrip_frames_received_total{{{UNIT}}}[5m]))", "in, {{via}}"),
                    (f"sum by (message) (rate(roadgrip_frames_sent_total{{{UNIT}}}[5m]))", "out, {{message}}"),
                    (f"sum by (reason) (rate(roadgrip_frames_dropped_total{{{UNIT}}}[5m]))", "dropped, {{reason}}"),
                    (f"rate(roadgrip_frame_duplicates_total{{{UNIT}}}[5m])", "repeated, {{via}}"),
                    (f"rate(roadgrip_frames_withheld_total{{{UNIT}}}[5m])", "withheld, {{message}}"),
                ),
            ),
            Panel(
                "Latency of a passage",
                "s",
                tuple(
                    (
                        f"histogram_quantile({quantile}, sum by (le) (rate({INGEST}_bucket{{{UNIT}}}[5m])))",
                        legend,
                    )
                    for quantile, legend in ((0.5, "half"), (0.95, "95 %"), (0.99, "99 %"))
                ),
                ((0.0, "green"), (0.1, "yellow"), (0.5, "red")),
                note="From the whole passage to its commit.",
            ),
            Panel(
                "Time of one call of the model",
                "s",
                (
                    (
                        f"rate({INFERENCE}_sum{{{UNIT}}}[5m]) / rate({INFERENCE}_count{{{UNIT}}}[5m])",
                        "{{instance}}",
                    ),
                ),
            ),
            Panel(
                "Work and its bounds",
                "short",
                (
                    (f"roadgrip_ingest_in_flight{{{UNIT}}}", "passages in work"),
                    (f"roadgrip_assemblies{{{UNIT}}}", "incomplete messages"),
                    (f"roadgrip_exchanges{{{UNIT}}}", "exchanges"),
                    (f"roadgrip_stream_clients{{{UNIT}}}", "event streams"),
                    (f"delta(roadgrip_udp_kernel_drops{{{UNIT}}}[5m])", "dropped by the kernel in 5 min"),
                ),
            ),
            Panel(
                "HTTP",
                "reqps",
                (
                    (
                        f"sum by (route, status) (rate(roadgrip_http_requests_total{{{UNIT}}}[5m]))",
                        "{{route}} {{status}}",
                    ),
                    (
                        f"sum by (reason) (rate(roadgrip_http_refusals_total{{{UNIT}}}[5m]))",
                        "refused: {{reason}}",
                    ),
                ),
            ),
        ),
    ),
    (
        "Store",
        (
            Panel(
                "Room on the disk",
                "percentunit",
                ((f"roadgrip_disk_free_bytes{{{UNIT}}} / roadgrip_disk_size_bytes{{{UNIT}}}", "{{instance}}"),),
                ((0.0, "red"), (0.1, "yellow"), (0.2, "green")),
                width_count=6,
            ),
            Panel(
                "Database",
                "bytes",
                ((f"roadgrip_store_bytes{{{UNIT}}}", "with its log, {{instance}}"),),
                width_count=6,
            ),
            Panel("Stored passages", "short", ((f"roadgrip_store_passages{{{UNIT}}}", "{{instance}}"),), width_count=6),
            Panel(
                "Writer",
                "s",
                (
                    (f"roadgrip_store_commit_age_seconds{{{UNIT}}}", "since the last commit"),
                    (f"roadgrip_store_writer_busy_seconds{{{UNIT}}}", "at the same writes"),
                ),
                ((0.0, "green"), (20.0, "yellow"), (60.0, "red")),
                width_count=6,
                note="The age grows on a quiet road until somebody asks whether the unit is ready.",
            ),
            Panel(
                "Passages that wait for a commit",
                "short",
                ((f"roadgrip_store_queue_depth{{{UNIT}}}", "{{instance}}"),),
                ((0.0, "green"), (100.0, "yellow"), (1000.0, "red")),
                width_count=6,
            ),
        ),
    ),
    (
        "Model",
        (
            Panel(
                "Bundles",
                "none",
                ((f"roadgrip_bundle_info{{{UNIT}}}", "{{instance}} {{role}}: {{bundle}}"),),
                kind="stat",
            ),
            Panel(
                "Stage of the newest release",
                "none",
                ((f"roadgrip_rollout_stage{{{UNIT}}} == 1", "{{instance}}: {{stage}}"),),
                kind="stat",
            ),
            Panel(
                "Releases refused, by reason",
                "short",
                (
                    (
                        f"sum by (reason) (increase(roadgrip_update_refusals_total{{{UNIT}}}[1d]))",
                        "{{reason}} in a day",
                    ),
                ),
            ),
            Panel(
                "Two bundles side by side",
                "percentunit",
                (
                    (f"roadgrip_shadow_median_ratio{{{UNIT}}}", "median difference"),
                    (f"roadgrip_shadow_spread_ratio{{{UNIT}}}", "nine in ten stay below"),
                ),
                ((0.0, "green"), (0.12, "yellow"), (0.4, "red")),
            ),
            Panel(
                "Drift",
                "percentunit",
                (
                    (f"roadgrip_drift_own_moved_frac{{{SECTION}}}", "{{section}}: features that moved"),
                    (f"roadgrip_drift_out_of_envelope_frac{{{SECTION}}}", "{{section}}: outside the envelope"),
                ),
            ),
            Panel(
                "Drift alarms",
                "bool_yes_no",
                ((f"max by (section, alarm) (roadgrip_drift_alarm{{{SECTION}}})", "{{section}}: {{alarm}}"),),
                ((0.0, "green"), (1.0, "orange")),
                "stat",
            ),
        ),
    ),
    (
        "Clock",
        (
            Panel(
                "Something keeps the wall clock right",
                "bool_yes_no",
                ((f"roadgrip_clock_synchronised{{{UNIT}}}", "{{instance}}"),),
                ((0.0, "orange"), (1.0, "green")),
                "stat",
            ),
            Panel(
                "How wrong it may be",
                "s",
                ((f"roadgrip_clock_max_error_seconds{{{UNIT}}}", "{{instance}}"),),
                ((0.0, "green"), (1.0, "yellow"), (60.0, "red")),
            ),
            Panel(
                "Times it was set",
                "short",
                ((f"increase(roadgrip_clock_steps_total{{{UNIT}}}[1h])", "{{instance}}"),),
            ),
        ),
    ),
    (
        "Resources",
        (
            Panel(
                "Processor",
                "percentunit",
                ((f'rate(process_cpu_seconds_total{{job="roadgrip",{UNIT}}}[5m])', "{{instance}}, of one core"),),
                ((0.0, "green"), (0.7, "yellow"), (1.2, "red")),
                width_count=6,
            ),
            Panel(
                "Memory",
                "bytes",
                (
                    (f'process_resident_memory_bytes{{job="roadgrip",{UNIT}}}', "{{instance}}"),
                    (f"roadgrip_memory_limit_bytes{{{UNIT}}}", "limit of {{instance}}"),
                ),
                ((0.0, "green"), (157286400.0, "yellow"), (402653184.0, "red")),
                width_count=6,
            ),
            Panel(
                "Open files",
                "short",
                ((f'process_open_fds{{job="roadgrip",{UNIT}}}', "{{instance}}"),),
                width_count=6,
            ),
            Panel(
                "Up since",
                "dateTimeAsIso",
                ((f'process_start_time_seconds{{job="roadgrip",{UNIT}}} * 1000', "{{instance}}"),),
                kind="stat",
                width_count=6,
            ),
            Panel(
                "Log lines dropped",
                "short",
                ((f"increase(roadgrip_log_lines_dropped_total{{{UNIT}}}[1h])", "{{instance}}, in an hour"),),
                width_count=6,
            ),
            Panel(
                "Certificates end in",
                "d",
                (
                    (f"roadgrip_http_certificate_days{{{UNIT}}}", "HTTPS, {{instance}}"),
                    (
                        f"(roadgrip_signing_certificate_ends_unix_seconds{{{UNIT}}} - time()) / 86400",
                        "signatures, {{instance}}",
                    ),
                ),
                ((0.0, "red"), (21.0, "yellow"), (60.0, "green")),
                "stat",
                6,
            ),
            Panel(
                "Versions",
                "none",
                ((f"roadgrip_build_info{{{UNIT}}}", "{{instance}}: {{version}}, Python {{python}}"),),
                kind="stat",
                width_count=6,
            ),
        ),
    ),
)


def dashboard() -> dict[str, Any]:
    """Return the dashboard as Grafana imports it."""
    return {
        "uid": "roadgrip",
        "title": "roadgrip: road side units",
        "tags": ["roadgrip"],
        "schemaVersion": 39,
        "version": 1,
        "editable": True,
        "refresh": "30s",
        "time": {"from": "now-6h", "to": "now"},
        "timezone": "browser",
        "templating": {
            "list": [
                {"name": "source", "label": "Source", "type": "datasource", "query": "prometheus"},
                _choice("unit", "Unit", "label_values(roadgrip_ready, instance)"),
                _choice("section", "Section", 'label_values(roadgrip_window_passages{instance=~"$unit"}, section)'),
            ]
        },
        "panels": list(_placed()),
    }


def _choice(name: str, label: str, query: str) -> dict[str, Any]:
    return {
        "name": name,
        "label": label,
        "type": "query",
        "datasource": SOURCE,
        "query": {"query": query, "refId": name},
        "definition": query,
        "includeAll": True,
        "multi": True,
        "refresh": 2,
        "sort": 1,
        "current": {"text": "All", "value": "$__all"},
    }


def _placed() -> Iterator[dict[str, Any]]:
    """Give all panels from left to right and from top to bottom, under the titles of their rows."""
    number, top = 1, 0
    for title, panels in ROWS:
        yield {"id": number, "type": "row", "title": title, "collapsed": False, "panels": []} | _place(0, top, 24, 1)
        number, top, left = number + 1, top + 1, 0
        height_count = 4 if all(panel.kind == "stat" for panel in panels) else 8
        for panel in panels:
            if left + panel.width_count > COLUMNS_COUNT:
                left, top = 0, top + height_count
            yield _panel(panel, number) | _place(left, top, panel.width_count, height_count)
            number, left = number + 1, left + panel.width_count
        top += height_count


def _place(left: int, top: int, width_count: int, height_count: int) -> dict[str, Any]:
    return {"gridPos": {"x": left, "y": top, "w": width_count, "h": height_count}}


def _panel(panel: Panel, number: int) -> dict[str, Any]:
    steps: list[dict[str, Any]] = [{"value": value, "color": color} for value, color in panel.steps]
    if steps:
        steps[0]["value"] = None  # Grafana's word for "from the lowest value on"
    stat = panel.kind == "stat"
    named = panel.unit == "none" and stat
    return {
        "id": number,
        "type": panel.kind,
        "title": panel.title,
        "description": panel.note,
        "datasource": SOURCE,
        "fieldConfig": {
            "defaults": {
                "unit": panel.unit,
                "color": {"mode": "thresholds" if stat and steps else "palette-classic"},
                "thresholds": {"mode": "absolute", "steps": steps or [{"value": None, "color": "green"}]},
                "custom": {} if stat else {"thresholdsStyle": {"mode": "dashed" if steps else "off"}},
            },
            "overrides": [],
        },
        "options": {"textMode": "name" if named else "auto", "reduceOptions": {"calcs": ["lastNotNull"]}}
        if stat
        else {"legend": {"displayMode": "list", "placement": "bottom"}, "tooltip": {"mode": "multi"}},
        "targets": [
            {"refId": chr(ord("A") + i), "datasource": SOURCE, "expr": query, "legendFormat": legend}
            for i, (query, legend) in enumerate(panel.series)
        ],
    }


def dashboard_text() -> str:
    """Return the dashboard as its file holds it."""
    return json.dumps(dashboard(), indent=1) + "\n"


if __name__ == "__main__":
    DASHBOARD_FILE.write_text(dashboard_text(), encoding="utf-8")
    print(DASHBOARD_FILE)
