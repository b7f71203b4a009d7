"""The card of a bundle says what the manifest says, and leaves out what it does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from roadgrip.bundle import BundleManifest
from roadgrip.errors import BundleError
from tests.training.runs import made_up_runs
from training.bundle_card import CARD_NAME, card_of
from training.bundling import write_bundle
from training.cli import app
from training.fit_parameters import FitParameters
from training.regressor import fit

VERSION = f"v{made_up_runs(10).table.version}"
METRICS = {
    f"{figure}.{part}.{VERSION}": value
    for part, error in (("known_roads", 0.031), ("unseen_roads", 0.222), ("unseen_roads.friction_30_40", 0.157))
    for figure, value in (("rows_count", 40.0), ("mape_ratio", error), ("at_least_frac", 0.25))
}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, BundleManifest]:
    folder = tmp_path_factory.mktemp("bundle")
    runs = made_up_runs(400)
    fitted = fit(runs, FitParameters(trees_count=3))
    provenance = {"command": "a test", "intended_use": "to be read by a test"}
    manifest = write_bundle(runs, fitted, folder, name="small", provenance=provenance, rng=np.random.default_rng(2))
    return folder, manifest


def with_metrics(manifest: BundleManifest, metrics: dict[str, float]) -> BundleManifest:
    return BundleManifest(
        manifest.name, manifest.bundle_id, manifest.models, metrics, manifest.provenance, manifest.files_sha256
    )


def test_the_card_names_the_bundle_its_use_and_its_plain_figures(written: tuple[Path, BundleManifest]) -> None:
    _, manifest = written
    card = card_of(manifest)
    assert manifest.bundle_id in card
    assert "| Intended use | to be read by a test |" in card
    assert f"{100 * manifest.metrics['mape_ratio']:.1f} %" in card


def test_parts_that_were_judged_have_a_row_and_others_none(written: tuple[Path, BundleManifest]) -> None:
    card = card_of(with_metrics(written[1], METRICS))
    assert "| these three roads | 40 | 3.1 % | 25.0 % | - | - |" in card
    assert "| - friction 0.3 to 0.4 | 40 | 15.7 %" in card
    assert "Sharp turn" not in card


def test_the_card_says_where_it_is_at_its_worst(written: tuple[Path, BundleManifest]) -> None:
    assert "roads never seen, 22.2 %" in card_of(with_metrics(written[1], METRICS))


def test_the_command_prints_the_card_or_writes_it_into_a_page(
    written: tuple[Path, BundleManifest], tmp_path: Path
) -> None:
    folder, manifest = written
    printed = CliRunner().invoke(app, ["card", str(folder)])
    assert printed.stdout.strip() == card_of(manifest).strip()
    page = tmp_path / "page.md"
    page.write_text(f"before\n<!-- table: {CARD_NAME} -->\n<!-- end of table -->\nafter\n", encoding="utf-8")
    assert CliRunner().invoke(app, ["card", str(folder), "--into", str(page)]).exit_code == 0
    assert card_of(manifest) in page.read_text(encoding="utf-8")
    assert page.read_text(encoding="utf-8").endswith("after\n")


def test_what_is_no_bundle_and_what_has_no_marks_is_refused(
    written: tuple[Path, BundleManifest], tmp_path: Path
) -> None:
    assert isinstance(CliRunner().invoke(app, ["card", str(tmp_path)]).exception, BundleError)
    page = tmp_path / "page.md"
    page.write_text("nothing\n", encoding="utf-8")
    result = CliRunner().invoke(app, ["card", str(written[0]), "--into", str(page)])
    assert "no marks" in str(result.exception)
