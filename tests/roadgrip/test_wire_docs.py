"""What docs/wire.md says is true."""

import re
from pathlib import Path

import pytest

from bench.bench_wire import EXCHANGE, exchange_messages, frames_of, size_table
from bench.measurement import ROADS
from roadgrip.protocol import FRAGMENT_BYTES, FRAME_LIMIT_BYTES, FRAMES_LIMIT_COUNT, HEADER_BYTES, REASON_CODES
from roadgrip.reasons import Reason
from roadgrip.records import RSU_FRAME_BUDGET, VEHICLE_FRAME_BUDGET
from roadgrip.sections import read_section
from roadgrip.wire import Kind

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "wire.md").read_text(encoding="utf-8")


def between(marker: str) -> str:
    """Return what stands between two marks in the page."""
    _, rest = TEXT.split(f"<!-- {marker} -->\n")
    inside, _ = rest.split(f"<!-- /{marker} -->")
    return inside


def rows(table: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("| ").split("|")] for line in table.strip().splitlines()[2:]]


def test_every_reason_is_listed_with_its_code_and_whether_to_retry():
    listed = {(int(code), reason.strip("`"), retry) for code, reason, _, retry in rows(between("reasons"))}
    assert listed == {(REASON_CODES[r], r.value, "yes" if r.may_retry else "no") for r in Reason}


def test_the_table_of_sizes_is_true():
    assert between("sizes") == size_table()


@pytest.mark.parametrize("road", ROADS)
@pytest.mark.parametrize("signed", [False, True])
def test_a_whole_exchange_takes_no_more_than_six_frames(road, signed):
    section = read_section(road)
    messages = exchange_messages(section)
    frames = [frame for kind in EXCHANGE for frame in frames_of(messages[kind], section, signed=signed)]
    assert len(frames) <= 6


def test_the_kinds_are_listed_with_code_and_frames():
    listed = re.findall(r"^\| ([A-Z]+) \| (\d) \| (?:vehicle|unit) \| `\w+` \| (?:1 to )?(\d) \|", TEXT, re.MULTILINE)
    assert {(name, int(code), int(frames)) for name, code, frames in listed} == {
        (kind.name, kind.value, FRAMES_LIMIT_COUNT[kind]) for kind in Kind
    }


def test_the_header_table_covers_the_header_without_a_gap():
    table = TEXT.split("| offset | bytes | content |")[1].split("\n\n")[0]
    fields = [(int(offset), int(size)) for offset, size in re.findall(r"^\| (\d+) \| (\d+) \|", table, re.MULTILINE)]
    ends = [offset + size for offset, size in fields]
    assert [offset for offset, _ in fields] == [0, *ends[:-1]]
    assert ends[-1] == HEADER_BYTES


def test_the_limits_in_the_text_are_those_of_the_code():
    assert f"at most {FRAME_LIMIT_BYTES:,} bytes" in TEXT
    assert f"header of {HEADER_BYTES} bytes" in TEXT
    assert f"{FRAGMENT_BYTES:,} for all but the last" in TEXT
    assert f"{VEHICLE_FRAME_BUDGET} of the vehicle, {RSU_FRAME_BUDGET} of the unit" in TEXT
