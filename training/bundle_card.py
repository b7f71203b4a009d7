"""The card of a bundle: what it is for, what it learned from, how good it is and where it is not, from its manifest."""

from __future__ import annotations

import re

from roadgrip.bundle import BundleManifest, ModelManifest
from roadgrip.features import table_of
from training.marked_tables import percent, table

CARD_NAME = "bundle.card"
"""Of the card between the marks of a page."""
_STATED = (
    ("Intended use", "intended_use"),
    ("Learned from", "learned_from"),
    ("Failed", "failed"),
    ("Judged on", "judged_on"),
    ("Limits", "limits"),
    ("Made by", "command"),
)
_PARTS = (
    ("Long turn", "known_roads.long-turn"),
    ("S-turn", "known_roads.s-turn"),
    ("Sharp turn", "known_roads.sharp-turn"),
    ("these three roads", "known_roads"),
    ("roads never seen", "unseen_roads"),
    ("- usual drivers", "unseen_roads.usual_drivers"),
    ("- drivers of any speed", "unseen_roads.any_speed"),
    ("- two turns of different friction", "unseen_roads.two_frictions"),
    ("- at least 60 % of the grip used", "unseen_roads.high_use"),
    ("- less of it used", "unseen_roads.low_use"),
    ("- less than a third of it used", "unseen_roads.little_use"),
    ("roads never seen, exact sensors", "exact_sensors"),
    ("own roads, measured", "own_roads"),
    ("own roads, as if never seen", "own_roads_as_unseen"),
)
_GRADES = (
    ("fresh roads, automotive sensors", "fresh_roads_automotive"),
    ("- of which the cars remember the errors", "fresh_roads_automotive_remembering"),
    ("fresh roads, ideal sensors", "fresh_roads_ideal"),
)
_FIGURES = (
    ("drives", "rows_count"),
    ("error", "mape_ratio"),
    ("at least", "at_least_frac"),
    ("error of the others", "mape_ratio_not_doubtful"),
    ("interval holds", "coverage_frac"),
)
_BAND = re.compile(r"rows_count\.(unseen_roads\.friction_(\d+)_(\d+))\.v\d+")
_ROADS = ("long-turn", "s-turn", "sharp-turn")


def card_of(manifest: BundleManifest) -> str:
    """Return the card as Markdown, without a heading.

    Figures that the manifest lacks have no row; a bundle of one model from `roadgrip-train bundle` has a short card.
    """
    parts = [f"`{manifest.bundle_id}`, {manifest.name}.\n", _stated(manifest)]
    for model in manifest.models:
        figures = _figures(manifest, f"v{table_of(model.table_digest, subject=manifest.name).version}")
        if figures:
            parts.append(f"{_title(model)}:\n\n{figures}")
    parts += [text for text in (_strange(manifest), _plain(manifest), _weakness(manifest)) if text]
    return "\n".join(parts)


def _title(model: ModelManifest) -> str:
    spoken = table_of(model.table_digest, subject="the card")
    low, high = model.mu_range
    return f"Feature table {spoken.version}, {len(spoken)} features, friction {low:.2f} to {high:.2f}"


def _stated(manifest: BundleManifest) -> str:
    rows = [[title, _said(manifest, key)] for title, key in _STATED if key in manifest.provenance]
    rows.append(["Serves", "; ".join(_title(model).lower() for model in manifest.models)])
    for model in manifest.models:
        version = table_of(model.table_digest, subject="the card").version
        for key in (f"fit.v{version}", "fit_parameters"):
            if key in manifest.provenance:
                rows.append([f"Trees of table {version}", _said(manifest, key)])
                break
        if model.conformal is not None:
            meant = model.conformal
            coverage = percent(meant.coverage_frac, digits=0)
            doubtful = percent(meant.doubtful_above_ratio, digits=0)
            said = (
                f"the truth lies within a factor of exp(± {meant.quantile:.2f} e) of an estimate with the expected "
                f'error e in {coverage} of the passages; above {doubtful} a passage only says "at least"'
            )
            rows.append([f"Errors of table {version}", said])
    return table(("", ""), rows)


def _said(manifest: BundleManifest, key: str) -> str:
    text = manifest.provenance[key].replace("|", "\\|")
    return f"`{text}`" if key.startswith(("command", "fit")) else text


def _figures(manifest: BundleManifest, version: str) -> str:
    bands = {found[1]: (int(found[2]), int(found[3])) for name in manifest.metrics if (found := _BAND.fullmatch(name))}
    named = [
        *_PARTS,
        *((_band_title(*bands[key]), key) for key in sorted(bands, key=lambda key: bands[key])),
        *_GRADES,
    ]
    rows = [
        [title, *(_figure(manifest, figure, f"{key}.{version}") for _, figure in _FIGURES)]
        for title, key in named
        if f"mape_ratio.{key}.{version}" in manifest.metrics
    ]
    mean = manifest.metrics.get(f"mape_ratio.mean_unseen_road.{version}")
    if mean is not None:
        rows.append(["mean over roads never seen", "", percent(mean), "", "", ""])
    return table(("", *(title for title, _ in _FIGURES)), rows) if rows else ""


def _band_title(low_percent: int, high_percent: int) -> str:
    if low_percent == 0:
        return f"- friction below {high_percent / 100:.1f}"
    if high_percent >= 100:
        return f"- friction {low_percent / 100:.1f} and more"
    return f"- friction {low_percent / 100:.1f} to {high_percent / 100:.1f}"


def _figure(manifest: BundleManifest, figure: str, key: str) -> str:
    value = manifest.metrics.get(f"{figure}.{key}")
    if value is None:
        return "-"
    return f"{value:.0f}" if figure == "rows_count" else percent(value)


def _strange(manifest: BundleManifest) -> str:
    named = (*_PARTS, *_GRADES)
    rows = [
        [title, percent(manifest.metrics[f"strange_frac.{key}"])]
        for title, key in named
        if f"strange_frac.{key}" in manifest.metrics
    ]
    return "Called strange, and stored without being counted:\n\n" + table(("", "share"), rows) if rows else ""


def _plain(manifest: BundleManifest) -> str:
    """Return the figures of a bundle with a single, plainly judged model."""
    metrics = manifest.metrics
    if "mape_ratio" not in metrics:
        return ""
    rows = [[name, percent(metrics[f"mape_ratio.{name}"])] for name in _ROADS if f"mape_ratio.{name}" in metrics]
    rows.append(["all roads", percent(metrics["mape_ratio"])])
    if "mape_ratio_unseen_roads" in metrics:
        rows.append(["mean over roads never seen", percent(metrics["mape_ratio_unseen_roads"])])
    head = f"Mean error relative to the truth, {metrics['rows_count']:.0f} drives that were not learned from"
    return f"{head}:\n\n{table(('road', 'error'), rows)}"


def _weakness(manifest: BundleManifest) -> str:
    """Return where the first model is at its worst, and what it makes of it."""
    if not manifest.models:
        return ""
    spoken = table_of(manifest.models[0].table_digest, subject=manifest.name)
    version = f"v{spoken.version}"
    found = {
        key: (title.removeprefix("- "), manifest.metrics[f"mape_ratio.{key}.{version}"])
        for title, key in _PARTS
        if f"mape_ratio.{key}.{version}" in manifest.metrics
    }
    if not found:
        return ""
    key, (title, worst) = max(found.items(), key=lambda each: each[1][1])
    text = f"At its worst by table {spoken.version}: {title}, {percent(worst)}"
    doubtful = manifest.metrics.get(f"at_least_frac.{key}.{version}")
    others = manifest.metrics.get(f"mape_ratio_not_doubtful.{key}.{version}")
    if doubtful is not None and others is not None:
        text += f'; {percent(doubtful)} of these passages only say "at least", the others are off by {percent(others)}'
    return f"{text}.\n"
