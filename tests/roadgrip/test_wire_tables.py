"""Summaries of several feature tables on the air."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from bench.bench_wire import exchange_messages, frames_of
from roadgrip.errors import WireError
from roadgrip.features import PAPER_TABLE, TABLES, FeatureTable
from roadgrip.protocol import Kind
from roadgrip.reasons import Reason
from roadgrip.records import KinematicSummary, MapOffer, Passage
from roadgrip.wire import decode_message, encode_message, rounded_to_wire
from tests.roadgrip.roads import PAPER_ROADS, packaged
from tests.roadgrip.tables import WIDER_TABLE
from tests.roadgrip.wire_samples import PASSAGE

FRAMES_LIMIT_COUNT = 6
EXCHANGE = ("ARRIVAL", "MAP", "ADVISORY", "SUMMARY", "RECEIPT")


def passage_of(table: FeatureTable, *, values_count: int | None = None) -> Passage:
    count = len(table.kinematic) if values_count is None else values_count
    values = np.random.default_rng(5).normal(size=count).astype(np.float32)
    summary = KinematicSummary(tuple(float(v) for v in values), table.digest, 31.27)
    return dataclasses.replace(PASSAGE, summary=summary)


def exchange_frames_count(section, table: FeatureTable) -> int:
    messages = exchange_messages(section)
    passage = dataclasses.replace(
        passage_of(table), passage_id=bytes(range(16)), section_id=section.section_id, map_version=section.version
    )
    messages |= {"MAP": MapOffer(section, (*TABLES, WIDER_TABLE.digest)), "SUMMARY": passage}
    return sum(len(frames_of(messages[kind], section, signed=True)) for kind in EXCHANGE)


@pytest.mark.parametrize("road", PAPER_ROADS)
@pytest.mark.parametrize("table", [*TABLES.values(), WIDER_TABLE], ids=lambda table: f"version-{table.version}")
def test_an_exchange_stays_within_six_frames(road, table):
    assert exchange_frames_count(packaged(road), table) <= FRAMES_LIMIT_COUNT


def test_a_summary_is_one_frame_however_wide_its_table():
    section = packaged(PAPER_ROADS[0])
    for table in (*TABLES.values(), WIDER_TABLE):
        assert len(frames_of(passage_of(table), section, signed=True)) == 1


def test_every_table_has_its_own_number_of_statistics(wider_table):
    for table in TABLES.values():
        passage = passage_of(table)
        assert rounded_to_wire(passage) == passage
        for wrong in (len(table.kinematic) - 1, len(table.kinematic) + 1):
            with pytest.raises(WireError) as refused:
                encode_message(passage_of(table, values_count=wrong))
            assert refused.value.reason is Reason.MALFORMED


def test_a_summary_of_an_unknown_table_arrives_whole_with_its_digest():
    assert WIDER_TABLE.digest not in TABLES
    passage = passage_of(WIDER_TABLE)
    arrived = decode_message(Kind.SUMMARY, encode_message(passage))
    assert arrived == passage


def test_more_statistics_than_any_table_has_are_refused():
    unknown = dataclasses.replace(PAPER_TABLE, version=999)
    with pytest.raises(WireError) as refused:
        encode_message(passage_of(unknown, values_count=257))
    assert refused.value.reason is Reason.MALFORMED
