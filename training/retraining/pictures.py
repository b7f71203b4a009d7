"""Pictures of a retrained model, by strangers' estimates of the drives it learned from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from roadgrip.units import BoolArray, FloatArray
from training.bundle_making import AS_UNSEEN, MadeBundle
from training.designs import PAPER_ROADS
from training.report.svg_picture import MOST_POINTS_COUNT, svg_of, thinned
from training.study.picture import Axis, Bars, Cloud, Line, Picture, Scatter
from training.table_figures import FRICTION_BANDS_MU, OWN_ROADS, band_key, own_parts_of
from training.table_models import GrownModel

_MOST_FEATURES_COUNT = 20


def write_pictures(made: MadeBundle, folder: Path) -> None:
    """Write the pictures of a bundle as SVG files into a folder, made if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in pictures_of(made).items():
        (folder / f"{name}.svg").write_bytes(svg_of(picture))


def pictures_of(made: MadeBundle) -> dict[str, Picture]:
    """Return the pictures by the names of their files: errors by road and by friction, estimates, what trees ask."""
    bands = {f"{low:.1f} to {high:.1f}": f"unseen_roads.{band_key(low, high)}" for low, high in FRICTION_BANDS_MU}
    pictures: dict[str, Picture] = {
        "error-by-road": _errors(made, "Error by road", "road", _roads(made)),
        "error-by-friction": _errors(made, "Error on roads never seen, by friction", "true friction", bands),
    }
    for model in made.models:
        pictures[f"estimates-{model.plan.version}"] = _estimates(made, model)
        pictures[f"features-{model.plan.version}"] = _features(model)
    return pictures


def _roads(made: MadeBundle) -> dict[str, str]:
    """Return the parts of the figures that are roads, by their titles."""
    roads = {name: f"known_roads.{name}" for name in PAPER_ROADS}
    for part in own_parts_of(made.learned):
        name = part.removeprefix(OWN_ROADS).removeprefix(".")
        if name:
            roads |= {f"{name}, own drives": part, f"{name}, as if never seen": f"{AS_UNSEEN}.{name}"}
    return roads | {"never seen": "unseen_roads"}


def _errors(made: MadeBundle, title: str, x_title: str, parts: Mapping[str, str]) -> Bars:
    metrics, versions = made.manifest.metrics, [model.plan.version for model in made.models]
    shown = {name: part for name, part in parts.items() if f"mape_ratio.{part}.{versions[0]}" in metrics}
    return Bars(
        title=title,
        x_title=x_title,
        y_axis=Axis("mean error relative to the truth, %", low=0.0),
        names=tuple(shown),
        groups=tuple(
            (
                f"feature table {version.removeprefix('v')}",
                tuple(100.0 * metrics[f"mape_ratio.{part}.{version}"] for part in shown.values()),
            )
            for version in versions
        ),
    )


def _estimates(made: MadeBundle, model: GrownModel) -> Scatter:
    drives = made.learned
    clouds = [
        _cloud("known roads", drives.known, drives.label_mu, model.strangers.mu),
        _cloud("roads never seen", ~drives.known, drives.label_mu, model.strangers.mu),
    ]
    if drives.own is not None and model is made.models[0]:
        clouds.append(_cloud("own roads, as if never seen", drives.own, drives.label_mu, made.as_unseen.mu))
    ends = (float(drives.label_mu.min()), float(drives.label_mu.max()))
    return Scatter(
        title=f"Estimates by models that had not seen the drive, feature table {model.plan.table.version}",
        x_axis=Axis("true friction"),
        y_axis=Axis("estimate"),
        clouds=tuple(cloud for cloud in clouds if cloud.x),
        references=(Line("as it is", ends, ends, dashed=True),),
    )


def _cloud(name: str, rows: BoolArray, label_mu: FloatArray, mu: FloatArray) -> Cloud:
    cloud = Cloud(name, tuple(label_mu[rows].tolist()), tuple(mu[rows].tolist()))
    return thinned(cloud, most_count=MOST_POINTS_COUNT)


def _features(model: GrownModel) -> Bars:
    gain = model.friction.get_score(importance_type="total_gain")
    of_feature = {model.plan.features[int(key.removeprefix("f"))]: float(value) for key, value in gain.items()}
    first = sorted(of_feature, key=lambda name: (-of_feature[name], name))[:_MOST_FEATURES_COUNT]
    whole = sum(of_feature.values()) or 1.0
    return Bars(
        title=f"What the trees of feature table {model.plan.table.version} ask most",
        x_title="feature",
        y_axis=Axis("share of all gain, %", low=0.0),
        names=tuple(first),
        groups=(("gain", tuple(100.0 * of_feature[name] / whole for name in first)),),
    )
