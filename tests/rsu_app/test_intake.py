import asyncio

import pytest
from structlog.testing import capture_logs

from roadgrip.records import NotCounted, Passage
from rsu_app.intake import flag_names
from tests.rsu_app.fakes import make_passage, make_section
from tests.rsu_app.sites import make_unit

SECTION = make_section()


@pytest.mark.parametrize(
    ("passage", "outcome", "reason"),
    [
        (make_passage(SECTION), "counted", ""),
        (make_passage(SECTION, age_s=4000.0), "uncounted", "older_than_window"),
        (make_passage(SECTION, age_s=-1.0), "rejected", "impossible_age"),
    ],
)
def test_each_passage_writes_one_line_with_all_one_would_ask(passage: Passage, outcome, reason):
    under_test = make_unit(section=SECTION)
    with capture_logs() as lines:
        asyncio.run(under_test.intake.receive(passage, via="udp"))
    (line,) = lines
    told = {key: line[key] for key in ("event", "section", "outcome", "reason", "via", "age_s")}
    assert told == {
        "event": "passage",
        "section": SECTION.section_id,
        "outcome": outcome,
        "reason": reason,
        "via": "udp",
        "age_s": passage.age_s,
    }
    assert line["took_s"] >= 0.0


def test_several_reasons_not_to_count_are_one_label():
    both = NotCounted.OUT_OF_ENVELOPE | NotCounted.OLDER_THAN_WINDOW
    assert flag_names(both) == "out_of_envelope+older_than_window"
    assert flag_names(NotCounted.NONE) == ""


def test_latency_is_measured_by_the_machines_clock():
    under_test = make_unit(section=SECTION)
    asyncio.run(under_test.intake.receive(make_passage(SECTION), via="udp"))
    assert under_test.count("roadgrip_ingest_duration_seconds_count") == 1
    assert under_test.count("roadgrip_ingest_in_flight") == 0
