from __future__ import annotations

from math import inf

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from training.data.ground_truth import (
    GroundTruth,
    GroundTruthError,
    Measurement,
    RowReason,
    canonical_csv,
    ground_truth_digest,
    read_ground_truth,
    refused_csv,
    text_of_table,
)

HEADER = "section_id,from_utc,until_utc,mu,mu_sd,instrument"
ROW = "bend-7,2026-01-31T06:00:00Z,2026-01-31T07:00:00Z,0.35,0.02,ViaFriction 3"
NOW_UNIX_S = 1_770_000_000.0
"""2026-02-02 02:40 UTC."""
SIX_UNIX_S = 1_769_839_200.0


def read(*rows: str, header: str = HEADER) -> GroundTruth:
    return read_ground_truth("\n".join([header, *rows]), now_unix_s=NOW_UNIX_S)


def reasons(truth: GroundTruth) -> list[tuple[int, RowReason]]:
    return [(row.line_number, row.reason) for row in truth.refused]


def with_cells(**cells: str) -> str:
    return ",".join({**dict(zip(HEADER.split(","), ROW.split(","), strict=True)), **cells}.values())


THE_ROW = Measurement("bend-7", SIX_UNIX_S, SIX_UNIX_S + 3600.0, 0.35, 0.02, "ViaFriction 3")


def test_a_row_becomes_a_measurement():
    assert read(ROW) == GroundTruth((THE_ROW,), ())


def test_a_note_comes_along_and_may_be_left_out():
    truth = read(
        ROW + ",after salting",
        with_cells(section_id="other") + ",",
        with_cells(section_id="third"),
        header=HEADER + ",note",
    )
    assert [each.note for each in truth.measurements] == ["after salting", "", ""]


def test_columns_may_come_in_any_order_and_case():
    names = HEADER.split(",")
    cells = dict(zip(names, ROW.split(","), strict=True))
    turned = names[::-1]
    assert read(",".join(cells[name] for name in turned), header=",".join(turned).upper()).measurements == (THE_ROW,)


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_what_spreadsheets_write_is_read(line_end):
    text = line_end.join([HEADER, "", ROW, ",,,,,", ""])
    assert read_ground_truth("\ufeff" + text, now_unix_s=NOW_UNIX_S).measurements == (THE_ROW,)


def test_semicolons_go_with_decimal_commas():
    row = ROW.replace(",", ";").replace("0.35", "0,35").replace("0.02", "0,02")
    assert read(row, header=HEADER.replace(",", ";")).measurements == (THE_ROW,)


def test_a_quoted_decimal_comma_is_read_between_commas():
    assert read(ROW.replace("0.35", '"0,35"')).measurements == (THE_ROW,)


@pytest.mark.parametrize("moment", ["2026-01-31T07:00:00+01:00", "2026-01-31 06:00Z", "20260131T060000Z"])
def test_times_of_any_zone_are_the_same_moment(moment):
    assert read(with_cells(from_utc=moment)).measurements == (THE_ROW,)


@pytest.mark.parametrize(
    ("cells", "reason", "told"),
    [
        ({"mu": ""}, RowReason.MISSING, "mu is blank"),
        ({"instrument": " "}, RowReason.MISSING, "instrument is blank"),
        ({"instrument": "a\x07b"}, RowReason.MALFORMED, "unprintable"),
        ({"instrument": "x" * 201}, RowReason.MALFORMED, "more than 200"),
        ({"instrument": "a,b"}, RowReason.MALFORMED, "7 cells under 6 columns"),
        ({"instrument": '"open'}, RowReason.MALFORMED, "cannot be read"),
        ({"section_id": "Bend 7"}, RowReason.NOT_A_SECTION, "lower-case"),
        ({"from_utc": "2026-01-31T06:00:00"}, RowReason.NOT_A_TIME, "names no zone"),
        ({"from_utc": "31.01.2026 06:00"}, RowReason.NOT_A_TIME, "is no time"),
        ({"until_utc": "2026-02-30T06:00:00Z"}, RowReason.NOT_A_TIME, "is no time"),
        ({"from_utc": "1970-01-01T00:00:00Z"}, RowReason.OUT_OF_RANGE, "before the year 2000"),
        ({"mu": "slippery"}, RowReason.NOT_A_NUMBER, "is no number"),
        ({"mu": "nan"}, RowReason.NOT_A_NUMBER, "is no number"),
        ({"mu": "1_0"}, RowReason.NOT_A_NUMBER, "is no number"),
        ({"mu": "35"}, RowReason.OUT_OF_RANGE, "per cent"),
        ({"mu": "0"}, RowReason.OUT_OF_RANGE, "not within"),
        ({"mu": "1e999"}, RowReason.OUT_OF_RANGE, "inf"),
        ({"mu_sd": "0"}, RowReason.OUT_OF_RANGE, "mu_sd 0"),
        ({"mu_sd": "0.6"}, RowReason.OUT_OF_RANGE, "mu_sd 0.6"),
        ({"until_utc": "2026-01-31T06:00:00Z"}, RowReason.EMPTY_SPAN, "not after"),
        ({"until_utc": "2026-01-31T05:00:00Z"}, RowReason.EMPTY_SPAN, "not after"),
        ({"until_utc": "2026-02-01T06:00:01Z"}, RowReason.LONG_SPAN, "24 hours"),
        ({"from_utc": "2026-02-02T02:00:00Z", "until_utc": "2026-02-02T03:00:00Z"}, RowReason.FUTURE, "future"),
    ],
)
def test_a_row_that_cannot_be_used_is_refused_with_its_line_and_reason(cells, reason, told):
    bad = with_cells(**cells)
    truth = read(ROW, bad)
    assert truth.measurements == (THE_ROW,)
    assert reasons(truth) == [(3, reason)]
    assert told in truth.refused[0].message
    assert truth.refused[0].text == bad


@pytest.mark.parametrize(
    ("cells", "kept"),
    [
        ({"mu": "1.5"}, 1),
        ({"mu": "1.51"}, 0),
        ({"mu": "0.02"}, 1),
        ({"mu": "0.019"}, 0),
        ({"mu_sd": "0.5"}, 1),
        ({"mu_sd": "0.001"}, 1),
        ({"until_utc": "2026-02-01T06:00:00Z"}, 1),
        ({"from_utc": "2026-02-02T02:00:00Z", "until_utc": "2026-02-02T02:40:00Z"}, 1),
    ],
)
def test_limits_belong_to_what_is_allowed(cells, kept):
    assert len(read(with_cells(**cells)).measurements) == kept


def test_a_row_that_says_the_same_is_refused_and_names_the_first():
    truth = read(ROW, with_cells(from_utc="2026-01-31T07:00:00+01:00"))
    assert truth.measurements == (THE_ROW,)
    assert reasons(truth) == [(3, RowReason.DUPLICATE)]
    assert "line 2" in truth.refused[0].message


def test_another_note_says_nothing_new():
    truth = read(ROW + ",wet", ROW + ",damp", header=HEADER + ",note")
    assert [each.note for each in truth.measurements] == ["wet"]
    assert reasons(truth) == [(3, RowReason.DUPLICATE)]


def test_empty_cells_behind_a_row_are_no_cells():
    assert read(ROW + ",,").measurements == (THE_ROW,)
    assert reasons(read(ROW + ",,x")) == [(2, RowReason.MALFORMED)]


def test_two_that_contradict_each_other_are_both_refused():
    # 3 standard deviations of a difference of two with 0.02 each are 0.085.
    later = {"from_utc": "2026-01-31T06:59:00Z", "until_utc": "2026-01-31T08:00:00Z", "instrument": "RCR"}
    truth = read(ROW, with_cells(**later, mu="0.44"), with_cells(section_id="other", mu="0.9"))
    assert [each.section_id for each in truth.measurements] == ["other"]
    assert reasons(truth) == [(2, RowReason.CONTRADICTION), (3, RowReason.CONTRADICTION)]
    assert "line 3" in truth.refused[0].message
    assert "line 2" in truth.refused[1].message
    assert len(read(ROW, with_cells(**later, mu="0.43")).measurements) == 2


def test_spans_that_only_touch_contradict_nothing():
    after = {"from_utc": "2026-01-31T07:00:00Z", "until_utc": "2026-01-31T08:00:00Z"}
    assert len(read(ROW, with_cells(**after, mu="0.9")).measurements) == 2


def test_a_long_span_is_compared_with_all_that_lie_in_it():
    long = with_cells(until_utc="2026-01-31T12:00:00Z")
    early = with_cells(from_utc="2026-01-31T06:10:00Z", until_utc="2026-01-31T06:20:00Z", mu="0.36")
    late = with_cells(from_utc="2026-01-31T11:00:00Z", until_utc="2026-01-31T11:10:00Z", mu="0.7")
    truth = read(long, early, late)
    assert [each.mu for each in truth.measurements] == [0.36]
    assert reasons(truth) == [(2, RowReason.CONTRADICTION), (4, RowReason.CONTRADICTION)]


@pytest.mark.parametrize(
    ("header", "told"),
    [
        ("", "empty"),
        (HEADER.replace(",mu_sd", ""), "lacks mu_sd"),
        (HEADER + ",colour", "unknown 'colour'"),
        (HEADER + ",mu", "twice"),
        ('"section_id', "cannot be read"),
    ],
)
def test_a_table_with_another_header_is_none(header, told):
    with pytest.raises(GroundTruthError, match=told):
        read_ground_truth(header, now_unix_s=NOW_UNIX_S)


def test_a_header_alone_holds_nothing():
    assert read() == GroundTruth((), ())


def test_bytes_of_older_programs_are_text():
    assert text_of_table("Vägfriktion".encode("cp1252")) == "Vägfriktion"
    assert text_of_table("\ufeffVägfriktion".encode()) == "Vägfriktion"
    with pytest.raises(GroundTruthError, match="export it as UTF-8"):
        text_of_table(b"\x81\xff")


def test_refused_rows_are_told_with_what_they_said():
    text = refused_csv(read(with_cells(mu="35")).refused)
    assert text.splitlines()[0] == "line_number,reason,message,row"
    assert text.splitlines()[1].startswith("2,out_of_range,")
    assert '"bend-7,2026-01-31T06:00:00Z' in text


# Laws -----------------------------------------------------------------------------------------------------------------

WORD = st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S")), min_size=1, max_size=20)
MEASUREMENTS = st.lists(
    st.builds(
        lambda section_id, begin_ms, span_ms, mu, mu_sd, instrument, note: Measurement(
            section_id, begin_ms / 1000.0, (begin_ms + span_ms) / 1000.0, mu, mu_sd, instrument, note
        ),
        st.sampled_from(["bend", "s-turn"]),
        st.integers(946_684_800_000, 1_700_000_000_000),
        st.integers(1, 86_400_000),
        st.floats(0.02, 1.5),
        st.floats(0.001, 0.5),
        WORD,
        st.one_of(st.just(""), WORD),
    ),
    max_size=6,
    unique_by=lambda each: (each.section_id, each.from_unix_s),
)


@given(MEASUREMENTS)
def test_the_canonical_text_reads_back_to_what_was_kept(measurements):
    once = read_ground_truth(canonical_csv(measurements), now_unix_s=inf)
    again = read_ground_truth(canonical_csv(once.measurements), now_unix_s=inf)
    assert again == GroundTruth(once.measurements, ())
    assert set(once.measurements) <= set(measurements)
    # Nothing is lost but what contradicts something else.
    assert {row.reason for row in once.refused} <= {RowReason.CONTRADICTION}
    assert len(once.measurements) + len(once.refused) == len(measurements)


@given(MEASUREMENTS, st.randoms())
def test_the_digest_does_not_depend_on_the_order(measurements, random):
    turned = list(measurements)
    random.shuffle(turned)
    assert ground_truth_digest(turned) == ground_truth_digest(measurements)


def test_the_digest_sees_every_cell():
    cells = {"section_id": "b", "mu": "0.36", "mu_sd": "0.03", "instrument": "RCR", "from_utc": "2026-01-31T06:00:01Z"}
    cells |= {"until_utc": "2026-01-31T06:59:59.500Z"}
    others = [read(with_cells(**{name: value})).measurements for name, value in cells.items()]
    assert len({ground_truth_digest(each) for each in [(THE_ROW,), *others]}) == 7


CELL = st.one_of(st.sampled_from([*ROW.split(","), '"', ";", "0,5", "-1", "1e400"]), st.text(max_size=12))
TEXTS = st.one_of(
    st.text(),
    st.text(st.sampled_from('",;\r\n\x000.eZ-:+T\ufeff\ud800 abmu_')),
    st.builds(
        lambda header, rows, line_end: line_end.join([header, *rows]),
        st.sampled_from([HEADER, HEADER.replace(",", ";"), HEADER + ",note"]),
        st.lists(st.lists(CELL, max_size=8).map(",".join) | st.lists(CELL, max_size=8).map(";".join), max_size=4),
        st.sampled_from(["\n", "\r\n", "\r"]),
    ),
)


@given(TEXTS)
@example(HEADER + "\nb,0001-01-01T00:00:00+14:00,9999-12-31T23:59:59-14:00,0.3,0.1,x")
@example(HEADER + "\n" + "9" * 5000)
@example(HEADER + "\n" + "x" * 200_000)
def test_any_text_gives_a_result_or_an_error_of_ours(text):
    try:
        truth = read_ground_truth(text, now_unix_s=NOW_UNIX_S)
    except GroundTruthError:
        return
    assert canonical_csv(truth.measurements).encode()
    assert all(row.message and row.line_number >= 2 for row in truth.refused)


@given(st.binary(max_size=60))
def test_any_bytes_are_text_or_an_error_of_ours(content):
    try:
        text_of_table(content)
    except GroundTruthError:
        assert content
