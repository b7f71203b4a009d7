"""Drives of somebody else's under a bundle: what becomes of each, and what it all comes to."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.errors import ConfigurationError
from roadgrip.features import NEWEST_TABLE, PAPER_TABLE, TABLES, road_features
from roadgrip.records import KinematicSummary, NotCounted, Reason, Rejected
from roadgrip.section import RoadSection
from rsu_app.adapters.inference.onnx_model import load_bundle
from rsu_app.domain.interval import IntervalPolicy, friction_interval
from rsu_app.domain.judgement import Judgement, judgement
from rsu_app.domain.plausibility import summary_values
from tests.bundles import make_bundle, make_bundle_of_tables
from tests.training.recorded_drives import drive, roads
from training.evaluation import Judge, RecordedDrive, driven_passage, evaluated, lowest_moving_mean_mu, unreadable
from training.evaluation_bundle import judge_of, read_bundle
from training.evaluation_figures import Ending, band_of
from training.evaluation_report import PASSAGE_COLUMNS, csv_of, document_of, passage_cells
from vehicle_client.estimation.trace import part_of
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.vehicle_profile import PAPER_VEHICLE

S_BEND, HAIRPIN = roads()
WEIGHTS = {"speed_mean_mps": 0.03, "section_length_m": -0.0002}


def recorded(
    of: str = "s-bend", *, speed_mps: float = 15.0, label_mu: float | None = None, **more: Any
) -> RecordedDrive:
    trace = drive(of, speed_mps=speed_mps)
    friction = None if label_mu is None else np.full(trace.samples_count, label_mu)
    return RecordedDrive(f"{of} at {speed_mps:g}", trace, friction_mu=friction, **more)


def passage_of(given: RecordedDrive, sections: tuple[RoadSection, ...]) -> Any:
    return driven_passage(given, sections)


def always(*estimates_mu: float, flags: NotCounted = NotCounted.NONE) -> Judge:
    """Return a judge that gives these answers, whatever it is asked."""
    return lambda asked: [Judgement(mu, flags) for _, mu in zip(asked, estimates_mu, strict=True)]


def test_the_first_section_that_a_drive_passed_counts():
    for order in ((S_BEND, HAIRPIN), (HAIRPIN, S_BEND)):
        assert passage_of(recorded(), order).section == S_BEND
        assert passage_of(recorded("hairpin"), order).section == HAIRPIN
    twin = replace(S_BEND, section_id="twin")
    assert passage_of(recorded(), (twin, S_BEND)).section.section_id == "twin"
    assert passage_of(recorded(section_id="s-bend"), (twin, S_BEND)).section == S_BEND


def test_what_a_drive_gives_is_what_the_onboard_client_gives():
    given_drive = recorded(label_mu=0.5)
    found = passage_of(given_drive, (S_BEND,))
    outcome = summarise_passage(given_drive.trace, S_BEND)
    assert isinstance(outcome, Summarised)
    assert found.found == outcome.summary
    assert (found.entry_s, found.exit_s) == (outcome.match.entry_s, outcome.match.exit_s)
    assert found.label_mu == pytest.approx(0.5)


def test_a_drive_on_none_of_the_sections_says_why_of_each():
    found = passage_of(recorded("elsewhere"), (S_BEND, HAIRPIN))
    assert isinstance(found.found, Rejected)
    assert found.found.reason is Reason.WRONG_ROAD
    assert "s-bend: " in found.found.detail
    assert "hairpin: " in found.found.detail
    assert found.section is None


def test_half_a_drive_is_told_as_such_and_not_as_a_drive_elsewhere():
    whole = recorded(label_mu=0.4)
    part = part_of(whole.trace, from_s=0.0, to_s=20.0)
    half = replace(whole, trace=part, friction_mu=np.full(part.samples_count, 0.4))
    found = passage_of(half, (HAIRPIN, S_BEND))
    assert isinstance(found.found, Rejected)
    assert found.found.reason is Reason.PASSAGE_ABORTED
    assert found.label_mu == 0.4


def test_a_section_that_nobody_gave_is_named():
    with pytest.raises(ConfigurationError, match="said to be on section 'moon'; given are s-bend, hairpin"):
        passage_of(recorded(section_id="moon"), (S_BEND, HAIRPIN))


def test_estimates_are_those_of_a_unit(tmp_path):
    make_bundle(tmp_path / "bundle", weights=WEIGHTS)
    drives = [recorded(speed_mps=speed_mps) for speed_mps in (10.0, 14.0, 18.0)] + [recorded("hairpin")]
    driven = [passage_of(each, (S_BEND, HAIRPIN)) for each in drives]
    result = evaluated(driven, judge_of(read_bundle(tmp_path / "bundle")))
    unit = load_bundle(tmp_path / "bundle")
    for passage, each in zip(result.passages, driven, strict=True):
        digest = each.found.table_digest
        row = np.concatenate([summary_values(each.found), road_features(each.section, TABLES[digest])])
        assert passage.estimate_mu == float(unit.estimate(digest, row[None, :]).mu[0])
        assert passage.ending is Ending.COUNTED
    assert len({passage.estimate_mu for passage in result.passages}) == 4


def test_an_estimate_beyond_the_bundles_range_is_not_counted(tmp_path):
    make_bundle(tmp_path / "bundle", weights=WEIGHTS, mu_range=(0.2, 0.3))
    (passage,) = evaluated([passage_of(recorded(), (S_BEND,))], judge_of(read_bundle(tmp_path / "bundle"))).passages
    assert passage.ending is Ending.NOT_COUNTED
    assert passage.flags == NotCounted.ESTIMATE_OUT_OF_RANGE


def test_a_summary_that_cannot_be_is_refused_as_a_unit_does(tmp_path):
    make_bundle(tmp_path / "bundle")
    sound = passage_of(recorded(), (S_BEND,))
    assert isinstance(sound.found, KinematicSummary)
    broken = replace(sound, found=replace(sound.found, duration_s=10.0 * sound.found.duration_s))
    result = evaluated([sound, broken], judge_of(read_bundle(tmp_path / "bundle")))
    assert [each.ending for each in result.passages] == [Ending.COUNTED, Ending.REFUSED_BY_UNIT]
    assert result.refusals == {"refused_by_unit: impossible_duration": 1}


def test_every_drive_has_its_row_in_the_order_they_came():
    driven = [unreadable("a.csv", "no column b"), *(passage_of(recorded(of), (S_BEND,)) for of in ("s-bend", "x"))]
    result = evaluated(driven, always(0.4))
    assert [each.ending for each in result.passages] == [
        Ending.UNREADABLE,
        Ending.COUNTED,
        Ending.REFUSED_BY_VEHICLE,
    ]
    assert result.refusals == {"refused_by_vehicle: wrong_road": 1, "unreadable": 1}
    assert result.errors == {}


def test_errors_are_relative_to_the_label_and_told_by_section_and_friction():
    drives = [recorded(label_mu=0.5), recorded(label_mu=0.25), recorded("hairpin", label_mu=0.5), recorded()]
    driven = [passage_of(each, (S_BEND, HAIRPIN)) for each in drives]
    result = evaluated(driven, always(0.55, 0.20, 0.50, 0.9))
    errors = [each.error_ratio for each in result.passages]
    assert errors == [pytest.approx(0.1), pytest.approx(-0.2), pytest.approx(0.0), None]
    figures = result.errors["all estimates"]
    assert figures.passages_count == 3
    assert figures.mape_ratio == pytest.approx(0.1)
    assert figures.relative_rms_ratio == pytest.approx(np.sqrt(0.05 / 3.0))
    assert figures.bias_ratio == pytest.approx(-0.1 / 3.0)
    assert figures.worst_ratio == pytest.approx(0.2)
    assert result.errors_by_section["s-bend"].mape_ratio == pytest.approx(0.15)
    assert set(result.errors_by_friction) == {"0.2 to 0.3", "0.5 to 0.6"}


def test_flagged_estimates_have_an_error_but_no_interval():
    driven = [passage_of(recorded(label_mu=0.5), (S_BEND,))]
    result = evaluated(driven, always(0.6, flags=NotCounted.OUT_OF_ENVELOPE))
    assert set(result.errors) == {"all estimates", "flagged"}
    assert result.intervals == ()


def test_the_surest_are_those_with_the_smallest_expected_errors():
    passage = passage_of(recorded(label_mu=0.5), (S_BEND,))
    answers = [Judgement(0.5 + 0.05 * i, NotCounted.NONE, expected_error_ratio=0.1 * (i + 1)) for i in range(5)]
    result = evaluated([passage] * 5, lambda asked: answers)
    assert result.errors["surest 80 %"].passages_count == 4
    assert result.errors["surest 80 %"].worst_ratio == pytest.approx(0.3)


def test_intervals_are_the_units_own_by_section_and_group():
    estimates = (0.5, 0.52, 0.48, 0.3, 0.31)
    driven = [
        passage_of(recorded(label_mu=0.5, group="day" if i < 3 else "night"), (S_BEND,)) for i in range(len(estimates))
    ]
    day, night = evaluated(driven, always(*estimates)).intervals
    assert (day.section_id, day.group, night.group) == ("s-bend", "day", "night")
    assert day.interval == friction_interval([0.48, 0.5, 0.52], newest_age_s=0.0, policy=IntervalPolicy())
    assert day.midpoint_error_ratio == pytest.approx(0.0)
    assert (day.labels_inside_frac, night.labels_inside_frac) == (1.0, 0.0)


def test_the_documents_tell_every_drive_without_nan():
    driven = [unreadable("a.csv", "b"), passage_of(recorded(label_mu=0.5), (S_BEND,))]
    result = evaluated(driven, always(0.55))
    cells = [passage_cells(each) for each in result.passages]
    assert all(tuple(each) == PASSAGE_COLUMNS for each in cells)
    assert cells[0]["entry_s"] is None
    assert cells[1]["error_ratio"] == pytest.approx(0.1)
    assert csv_of(result.passages).splitlines()[0] == ",".join(PASSAGE_COLUMNS)
    assert len(csv_of(result.passages).splitlines()) == 3


@given(st.lists(st.floats(0.1, 1.0), min_size=2, max_size=40), st.floats(0.2, 5.0))
def test_the_lowest_moving_mean_is_no_higher_than_that_of_any_ten_metres(friction, step_m):
    friction_mu, station_m = np.array(friction), step_m * np.arange(len(friction))
    lowest = lowest_moving_mean_mu(station_m, friction_mu)
    assert lowest >= friction_mu.min() - 1e-9
    window_m = min(10.0, float(station_m[-1]))
    for start_m in (0.0, float(station_m[-1]) - window_m):
        fine_m = np.union1d(station_m, [start_m, start_m + window_m])
        fine_m = fine_m[(fine_m >= start_m) & (fine_m <= start_m + window_m)]
        mean_mu = float(np.trapezoid(np.interp(fine_m, station_m, friction_mu), fine_m) / window_m)
        # Exact only where windows begin and end at samples: between them the integral is taken as straight.
        assert lowest <= mean_mu + 0.25 * step_m * float(np.ptp(friction_mu)) / window_m + 1e-9


def test_a_slippery_patch_counts_by_its_share_of_ten_metres():
    station_m = np.arange(0.0, 100.0, 0.01)
    friction_mu = np.where((station_m >= 50.0) & (station_m < 55.0), 0.2, 0.6)
    assert lowest_moving_mean_mu(station_m, friction_mu) == pytest.approx(0.4, abs=1e-3)


@pytest.mark.parametrize(
    ("mu", "band"), [(0.3, "0.3 to 0.4"), (0.299, "0.2 to 0.3"), (0.7, "0.7 to 0.8"), (1.0, "1.0 to 1.1")]
)
def test_a_band_holds_its_lower_end(mu, band):
    assert band_of(mu) == band


def test_a_document_names_bundle_car_and_maps(tmp_path):
    manifest = make_bundle(tmp_path / "bundle")
    result = evaluated([passage_of(recorded(label_mu=0.5), (S_BEND,))], always(0.5))
    document = document_of(result, bundle=manifest, sections=(S_BEND,), vehicle=PAPER_VEHICLE)
    assert document["bundle"]["bundle_id"] == manifest.bundle_id
    assert document["sections"][0]["version"] == S_BEND.version
    assert document["vehicle"] == PAPER_VEHICLE.name
    assert document["endings"] == {"counted": 1}


def test_expected_errors_and_doubts_are_those_of_a_unit(tmp_path):
    manifest = make_bundle_of_tables(tmp_path / "bundle", [NEWEST_TABLE], biases_mu=[0.5])
    (model,) = manifest.models
    driven = [passage_of(recorded(speed_mps=speed_mps), (S_BEND,)) for speed_mps in (10.0, 18.0)]
    result = evaluated(driven, judge_of(read_bundle(tmp_path / "bundle")))
    unit = load_bundle(tmp_path / "bundle")
    for passage, each in zip(result.passages, driven, strict=True):
        row = np.concatenate([summary_values(each.found), road_features(each.section, NEWEST_TABLE)])
        answer = unit.estimate(model.table_digest, row[None, :])
        assert answer.expected_error_ratio is not None
        assert passage.expected_error_ratio == float(answer.expected_error_ratio[0])
        told = judgement(row, model, mu=float(answer.mu[0]), expected_error_ratio=float(answer.expected_error_ratio[0]))
        assert passage.at_least_mu == (told.mu_low if told.at_least else None)


def test_a_bundle_for_the_papers_features_is_asked_in_its_own_columns(tmp_path):
    make_bundle_of_tables(tmp_path / "bundle", [PAPER_TABLE], biases_mu=[0.4])
    (passage,) = evaluated([passage_of(recorded(), (S_BEND,))], judge_of(read_bundle(tmp_path / "bundle"))).passages
    assert passage.ending is Ending.COUNTED
