"""The page at `/`: what the unit would say if one asked it, without scripts, fonts or anything from elsewhere.

The only place of the unit where speeds are shown in km/h, since people read it.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from html import escape

from roadgrip.records import Advisory
from roadgrip.section import RoadSection
from roadgrip.units import mps_to_kph
from rsu_app.usecases import SectionFriction

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #1b2a33 }
h1 { margin-bottom: 0 } .quiet { color: #5c6f7b } .bad { color: #a3261d }
article { border: 1px solid #cdd8de; border-radius: .5rem; padding: 1rem 1.25rem; margin: 1.25rem 0 }
h2 { margin: 0 0 .5rem } .speed { font-size: 2.5rem; font-weight: 700 }
.bar { position: relative; height: 1rem; border-radius: .5rem }
.bar { background: linear-gradient(90deg, #c7dcec, #f4f1e6, #cfe6cf) }
.bar span { position: absolute; top: -.2rem; bottom: -.2rem; background: #1b2a33; border-radius: .3rem; opacity: .8 }
@media (prefers-color-scheme: dark) { body { background: #12191d; color: #dbe5ea } article { border-color: #3a4a53 }
 a { color: #8fc7ee } .bar span { background: #fff } .bar { background: #33434c } }
"""
_STYLE_DIGEST = base64.b64encode(hashlib.sha256(_STYLE.encode()).digest()).decode()
PAGE_HEADERS = {
    # Nothing but the style above and that of the bars: no script, no picture, no frame around it, from anywhere.
    "Content-Security-Policy": f"default-src 'none'; style-src-elem 'sha256-{_STYLE_DIGEST}'; "
    "style-src-attr 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
_MU_AXIS = 1.2
"""Right end of the bar; no road offers more."""


@dataclass(frozen=True, slots=True)
class SectionView:
    """A section, what is advised on it, and the friction behind it; None while no vehicle tells of any."""

    section: RoadSection
    advisory: Advisory
    friction: SectionFriction | None


@dataclass(frozen=True, slots=True)
class UnitState:
    """How the unit is, for operators' eyes only.

    Attributes:
        version: Version of the software.
        problems: Why the unit is not ready; empty when it is.
    """

    version: str
    problems: tuple[str, ...]


def status_page(views: Iterable[SectionView], *, state: UnitState | None) -> str:
    """Return the page as HTML.

    Args:
        views: The sections in the order of the configuration.
        state: None for whoever is no operator.
    """
    articles = "\n".join(_article(view) for view in views)
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta http-equiv="refresh" content="5"><title>roadgrip road side unit</title><style>{_STYLE}</style></head><body>
<h1>Road side unit</h1>
{"" if state is None else _state(state)}
{articles}
<p><a href="/docs">API, to try out</a> · <a href="/openapi.json">OpenAPI</a> · <a href="/metrics">metrics</a> ·
<a href="/health/ready">readiness</a> · <a href="/v1/sections">sections</a></p>
</body></html>
"""


def _state(state: UnitState) -> str:
    words = "ready" if not state.problems else "not ready: " + "; ".join(state.problems)
    mood = "bad" if state.problems else "quiet"
    return f'<p class="{mood}">roadgrip {escape(state.version)}, {escape(words)}</p>'


def _article(view: SectionView) -> str:
    section, advisory = view.section, view.advisory
    here = f"/v1/sections/{section.section_id}"
    if view.friction is None:
        friction = '<p class="quiet">No friction to publish.</p>'
    else:
        interval = view.friction.interval
        left = 100.0 * min(1.0, interval.mu_low / _MU_AXIS)
        width = 100.0 * min(1.0, interval.mu_new / _MU_AXIS) - left
        friction = (
            f'<div class="bar"><span style="left:{left:.1f}%;width:{max(0.5, width):.1f}%"></span></div>'
            f"<p>Friction {interval.mu_low:.2f} (worn tyre) to {interval.mu_new:.2f} (new tyre), "
            f"from {interval.passages_count} vehicles, the last {interval.newest_age_s / 60.0:.0f} min ago.</p>"
            f'<p class="quiet">{escape(_second_opinion(view.friction))}</p>'
        )
    return f"""<article><h2>{escape(section.name or section.section_id)}</h2>
<p><span class="speed">{mps_to_kph(advisory.speed_mps):.0f} km/h</span>
 <span class="quiet">{escape(_words(advisory.reason))} · confidence {escape(_words(advisory.confidence))}</span></p>
{friction}
<p class="quiet">{section.length_m:.0f} m, tightest radius {section.tightest_radius_m:.0f} m,
 limit {mps_to_kph(section.speed_limit_mps):.0f} km/h, map {escape(section.version)} ·
 <a href="{here}/advisory">advisory</a> · <a href="{here}/friction">friction</a> ·
 <a href="{here}/friction/stream">stream</a> · <a href="{here}/map">map</a></p></article>"""


def _second_opinion(friction: SectionFriction) -> str:
    refined = friction.refined
    if refined.at_least:
        text = f"Too few vehicles ({refined.informative_count}) name a friction: at least {refined.mu_low:.2f}."
    else:
        text = (
            f"With each vehicle's expected error: {refined.mu_low:.2f} to {refined.mu_new:.2f} "
            f"(upper end ± {refined.half_width_mu:.2f})."
        )
    if friction.since_change_s is not None:
        text += f" The friction changed {friction.since_change_s / 60.0:.0f} min ago; vehicles before do not count."
    return text


def _words(code: str) -> str:
    return str(code).replace("_", " ")
