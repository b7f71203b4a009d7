import asyncio

import pytest
from structlog.testing import capture_logs

from roadgrip.records import Accepted, NotCounted, Outcome, Passage
from rsu_app.intake import flag_names, into
from rsu_app.usecases import AcceptedAgain
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


def test_a_passage_counts_though_its_sender_has_stopped_waiting():
    async def story():
        under_test, passage = make_unit(section=SECTION), make_passage(SECTION)
        asking = asyncio.create_task(under_test.intake.receive(passage, via="http"))
        await asyncio.sleep(0.0)
        asking.cancel()
        assert isinstance(await under_test.intake.receive(passage, via="http"), AcceptedAgain)

    asyncio.run(story())


def test_whoever_waits_hears_of_an_answer_that_cannot_be_written():
    def unwritable(_: Outcome) -> str:
        raise OverflowError("too long")

    async def story():
        answer: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        into(answer, unwritable)(Accepted())
        with pytest.raises(OverflowError):
            await answer

    asyncio.run(story())
