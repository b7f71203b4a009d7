"""In which feature table's words a vehicle tells its summary."""

from __future__ import annotations

from roadgrip.features import PAPER_TABLE, TABLES, FeatureTable, older_summary, summary_among, summary_for
from roadgrip.records import Accepted, KinematicSummary, MapOffer, Passage, Reason, Receipt, Rejected
from tests.vehicle_client.shell.air import BEND, PASSAGE_ID, SUMMARY, Ether
from tests.vehicle_client.shell.test_exchange import an_exchange, hear
from vehicle_client.shell.exchange import Ending, Exchange, Stage
from vehicle_client.shell.patience import Patience


def a_wide_summary(table: FeatureTable) -> KinematicSummary:
    return KinematicSummary(tuple(0.01 * i for i in range(len(table.kinematic))), table.digest, duration_s=31.0)


def the_report(exchange: Exchange, ether: Ether, frames: tuple[bytes, ...]) -> KinematicSummary:
    (frame,) = frames
    passage = ether.cargo[frame][2]
    assert isinstance(passage, Passage)
    return passage.summary


def reporting(ether: Ether, summary: KinematicSummary, *, tables: tuple[str, ...] | None = None) -> Exchange:
    """Return an exchange that has sent its summary, to a unit that told its tables or did not need to."""
    exchange = an_exchange(ether, known=BEND)
    exchange.begin(now_s=0.0)
    if tables is not None:
        hear(exchange, ether, MapOffer(BEND, tables), now_s=0.1)
    frames = exchange.report(summary, map_version=BEND.version, left_at_s=9.0, now_s=10.0)
    spoken = summary if tables is None else summary_among(summary, tables)
    assert the_report(exchange, ether, frames) == spoken
    return exchange


def test_a_summary_is_told_in_the_newest_words_that_both_speak(wider_table: FeatureTable):
    summary = a_wide_summary(wider_table)
    reporting(Ether(), summary, tables=(wider_table.digest, PAPER_TABLE.digest))
    reporting(Ether(), summary, tables=(PAPER_TABLE.digest, "another-table"))


REFUSED_TABLE = Receipt(PASSAGE_ID, Rejected(Reason.WRONG_FEATURE_TABLE))


def test_a_vehicle_that_was_not_told_the_tables_goes_on_to_older_words(wider_table: FeatureTable):
    ether, summary = Ether(), a_wide_summary(wider_table)
    exchange = reporting(ether, summary)
    hear(exchange, ether, REFUSED_TABLE, now_s=10.1)
    hear(exchange, ether, REFUSED_TABLE, now_s=10.1)  # the air repeats it
    assert exchange.wake_at_s == 10.1
    assert the_report(exchange, ether, exchange.tick(now_s=10.1)) == older_summary(summary)
    hear(exchange, ether, Receipt(PASSAGE_ID, Accepted()), now_s=10.2)
    assert exchange.record().ending is Ending.ACCEPTED


def test_a_refusal_of_the_first_words_that_comes_late_does_not_end_the_exchange(wider_table: FeatureTable):
    ether = Ether()
    exchange = reporting(ether, a_wide_summary(wider_table))
    words_count = len(TABLES)
    for _ in range(words_count):
        hear(exchange, ether, REFUSED_TABLE, now_s=10.1)
        exchange.tick(now_s=10.1)
    assert exchange.stage is Stage.REPORTING
    hear(exchange, ether, Receipt(PASSAGE_ID, Accepted()), now_s=10.2)
    assert exchange.record().ending is Ending.ACCEPTED


def test_a_unit_that_serves_none_of_the_words_refuses_in_the_end(wider_table: FeatureTable):
    ether = Ether()
    exchange = reporting(ether, a_wide_summary(wider_table))
    now_s = 10.0
    while exchange.stage is Stage.REPORTING:
        hear(exchange, ether, REFUSED_TABLE, now_s=now_s + 0.1)
        now_s = max(now_s + 0.1, exchange.wake_at_s)
        exchange.tick(now_s=now_s)
    record = exchange.record()
    assert (record.ending, record.outcome) == (Ending.REJECTED, Rejected(Reason.WRONG_FEATURE_TABLE))
    assert not record.may_spool
    assert record.report_tries_count <= Patience().report_tries_count


def test_without_older_words_a_refused_table_is_final():
    ether = Ether()
    exchange = reporting(ether, summary_for(SUMMARY, next(iter(TABLES.values()))))
    hear(exchange, ether, REFUSED_TABLE, now_s=10.1)
    assert exchange.record().ending is Ending.REJECTED
