from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.features import PAPER_TABLE
from rsu_app.domain.drift import DriftAlarm
from tests.training.drift.exported_traffic import DAILY_COUNT, DAY_S, export_of, passages_of, watched_manifest
from training.drift.drift import Advice, DriftError, drift_of, moved_most

MANIFEST = watched_manifest()
WEEKS = range(28)


def judged(*groups, **more):
    """Return the drift of passages by unit; each group is a unit's."""
    exports = [export_of(MANIFEST, passages, unit=f"unit-{n}") for n, passages in enumerate(groups, start=1)]
    return drift_of(exports, MANIFEST, **more)


def test_unchanged_traffic_in_changing_weather_keeps_the_bundle():
    found = judged(passages_of(MANIFEST, WEEKS, seed=1))
    assert found.advice is Advice.KEEP
    (section,) = found.sections
    assert (section.unit, section.section_id, section.passages_count) == ("unit-1", "bend", 28 * DAILY_COUNT)
    assert section.baseline_count == 3 * 128
    assert len(section.periods) == 4
    latest = section.periods[-1].report
    assert latest.own_drifted_count == 0
    assert latest.own_rows_count == latest.total_count
    assert latest.own_road


def test_traffic_that_stays_changed_wants_a_new_bundle():
    found = judged(passages_of(MANIFEST, WEEKS, seed=1, changed_from_day=14))
    assert found.advice is Advice.RETRAIN
    alarms = [period.report.alarms for period in found.sections[0].periods]
    assert alarms == [(), (), (DriftAlarm.OWN_TRAFFIC,), (DriftAlarm.OWN_TRAFFIC,)]
    names = [name for name, _ in moved_most(found.sections)]
    assert names[0] in found.reasons[0]
    assert "for several periods at 1 of 1 sections: bend (unit-1)" in found.reasons[0]


def test_a_change_of_the_latest_period_at_one_of_many_sections_is_watched():
    quiet = [passages_of(MANIFEST, WEEKS, seed=seed) for seed in (2, 3)]
    found = judged(passages_of(MANIFEST, WEEKS, seed=1, changed_from_day=21), *quiet)
    assert found.advice is Advice.WATCH
    assert found.reasons[0].startswith("Traffic is not what it was at like friction in the latest period at 1 of 3")


def test_a_change_at_most_sections_does_not_wait():
    found = judged(*(passages_of(MANIFEST, WEEKS, seed=seed, changed_from_day=21) for seed in (1, 2, 3)))
    assert found.advice is Advice.RETRAIN
    assert moved_most(found.sections)[0][1] == 3


def test_passages_outside_the_envelope_are_counted_by_period():
    found = judged(passages_of(MANIFEST, WEEKS, seed=2, changed_from_day=14, outside_frac=0.5))
    section = found.sections[0]
    assert list(section.not_counted) == ["out_of_envelope"]
    assert section.periods[0].report.out_of_envelope_frac == 0.0
    assert section.periods[-1].report.out_of_envelope_frac == pytest.approx(0.5, abs=0.1)
    assert section.lasting(DriftAlarm.OUT_OF_ENVELOPE)
    assert found.pooled[2].out_of_envelope_frac == section.periods[-1].report.out_of_envelope_frac


def test_a_shadow_is_told_by_how_far_it_is_from_the_live_model():
    found = judged(passages_of(MANIFEST, range(7), seed=1, shadow_ratio=1.1))
    shadow = found.sections[0].periods[-1].shadow
    assert shadow is not None
    assert shadow.median_ratio == pytest.approx(np.log(1.1))
    assert shadow.passages_count == 7 * DAILY_COUNT
    assert judged(passages_of(MANIFEST, range(7), seed=1)).sections[0].periods[-1].shadow is None


def test_too_few_passages_are_watched_and_said_so():
    found = judged(passages_of(MANIFEST, range(7), seed=1)[-29:])
    assert found.advice is Advice.WATCH
    assert found.reasons == ("No section had 30 passages in the latest period: nothing can be judged.",)


def test_a_section_without_earlier_traffic_is_said():
    found = judged(passages_of(MANIFEST, range(1), seed=1))
    assert found.advice is Advice.KEEP
    assert found.reasons[-1].startswith("1 of them could not be held against earlier traffic")
    assert found.pooled[2].features


def test_what_taught_the_baseline_is_not_held_against_it():
    section = judged(passages_of(MANIFEST, WEEKS, seed=1)).sections[0]
    reports = [period.report for period in section.periods]
    assert sum(report.total_count - report.rows_count for report in reports) == section.baseline_count
    assert reports[0].rows_count < reports[0].total_count


def test_passages_that_do_not_count_teach_nothing():
    passages = [replace(each, flags=1) for each in passages_of(MANIFEST, range(14), seed=1)]
    assert judged(passages).sections[0].baseline_count == 0


def test_the_order_of_exports_and_lines_does_not_matter():
    # Exports tell coarse times: many passages left at one moment.
    passages = [
        replace(each, left_unix_s=DAY_S * (each.left_unix_s // DAY_S))
        for each in passages_of(MANIFEST, range(21), seed=1)
    ]
    shuffled = [passages[i] for i in np.random.default_rng(0).permutation(len(passages))]
    parts = [export_of(MANIFEST, shuffled[::2]), export_of(MANIFEST, shuffled[1::2])]
    assert repr(drift_of(parts, MANIFEST)) == repr(judged(passages))


def test_what_is_not_judged_is_counted():
    passages = passages_of(MANIFEST, range(3), seed=1)
    odd = [
        replace(passages[0], bundle_id="another"),
        replace(passages[1], table_digest=PAPER_TABLE.digest, left_unix_s=1.0),
        replace(passages[2], values=passages[2].values[:-1]),
        passages[3],
    ]
    found = judged([*passages, *odd])
    assert found.left_out == {
        "judged_by_another_bundle": 1,
        "of_a_wrong_width": 1,
        "of_another_feature_table": 1,
        "repeated": 1,
    }
    assert found.sections[0].passages_count == len(passages)


def test_exports_without_a_passage_of_the_bundle_are_refused():
    passages = [replace(each, bundle_id="another") for each in passages_of(MANIFEST, range(1), seed=1)[:2]]
    with pytest.raises(DriftError, match="2 judged by another bundle"):
        judged(passages)
    with pytest.raises(DriftError, match="no passage at all"):
        judged([])


def test_a_bundle_without_a_reference_is_said_and_the_rest_is_judged():
    bare = watched_manifest(with_references=False)
    found = drift_of([export_of(bare, passages_of(bare, WEEKS, seed=1, changed_from_day=14))], bare)
    assert found.advice is Advice.RETRAIN
    assert found.reasons[0].startswith("The bundle holds no training reference")
    assert found.sections[0].periods[-1].report.features == ()


def test_periods_end_with_the_last_passage_and_are_as_long_as_asked():
    found = judged(passages_of(MANIFEST, range(10), seed=1), period_s=2.0 * DAY_S)
    starts = [period.from_unix_s for period in found.sections[0].periods]
    assert starts[-1] == found.until_unix_s - 2.0 * DAY_S
    assert np.diff(starts).tolist() == [2.0 * DAY_S] * 4


def test_progress_is_told():
    heard = []
    judged(
        *(passages_of(MANIFEST, range(2), seed=seed) for seed in (1, 2)),
        on_section=lambda done, total: heard.append((done, total)),
    )
    assert heard == [(1, 2), (2, 2)]
