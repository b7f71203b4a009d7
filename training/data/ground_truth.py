"""What friction-measuring trailers say: a table of sections, spans of time, frictions and how uncertain they are.

The table is CSV as trailer software and spreadsheets write it: commas, or semicolons with decimal commas; with or
without a byte order mark; any line ends. A row that cannot be used is refused with its reason and stays in the report;
nothing is guessed, since a wrong label teaches a wrong friction.
"""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from itertools import groupby
from math import hypot

from roadgrip.errors import RoadgripError

COLUMNS = ("section_id", "from_utc", "until_utc", "mu", "mu_sd", "instrument")
NOTE_COLUMN = "note"
MU_RANGE = (0.02, 1.5)
MU_SD_RANGE = (0.001, 0.5)
"""No instrument is exact, and one that may be off by more says nothing."""
SPAN_LIMIT_S = 86_400.0
"""Friction does not stay the same for longer; such a span is a slip of the pen."""
EARLIEST_UNIX_S = 946_684_800.0
"""2000-01-01; the clock of whoever measured earlier was not set."""
CONTRADICTION_SDS_RATIO = 3.0
"""Two measurements of one road at one time contradict each other when they lie so many standard deviations apart."""
_TEXT_LIMIT_CHARS = 200
_SECTION = re.compile(r"[a-z0-9-]{1,48}")
_NUMBER = re.compile(r"[+-]?[0-9]+([.,][0-9]+)?([eE][+-]?[0-9]{1,3})?")
_LINE_END = re.compile(r"\r\n|\n|\r")


class GroundTruthError(RoadgripError):
    """A text that is no table of measurements; the message says what it lacks."""


class RowReason(StrEnum):
    """Why a row is refused."""

    MALFORMED = "malformed"
    MISSING = "missing"
    NOT_A_SECTION = "not_a_section"
    NOT_A_TIME = "not_a_time"
    NOT_A_NUMBER = "not_a_number"
    OUT_OF_RANGE = "out_of_range"
    EMPTY_SPAN = "empty_span"
    LONG_SPAN = "long_span"
    FUTURE = "future"
    DUPLICATE = "duplicate"
    CONTRADICTION = "contradiction"


@dataclass(frozen=True, slots=True)
class Measurement:
    """What a trailer found on a section.

    Attributes:
        section_id: Where.
        from_unix_s: From when,
        until_unix_s: and until when it speaks for the road; this moment is no longer part of it.
        mu: The friction that its tyre found.
        mu_sd: Standard deviation of that.
        instrument: Which one measured.
        note: Whatever somebody wrote beside it.
    """

    section_id: str
    from_unix_s: float
    until_unix_s: float
    mu: float
    mu_sd: float
    instrument: str
    note: str = ""


@dataclass(frozen=True, slots=True)
class RefusedRow:
    """A row that is not used.

    Attributes:
        line_number: In the text, from 1.
        reason: Why, for machines.
        message: Why, for a person.
        text: The row as it was.
    """

    line_number: int
    reason: RowReason
    message: str
    text: str


@dataclass(frozen=True, slots=True)
class GroundTruth:
    """A table of measurements that was read.

    Attributes:
        measurements: By section and time.
        refused: In the order of the lines.
    """

    measurements: tuple[Measurement, ...]
    refused: tuple[RefusedRow, ...]


class _RowRefusal(Exception):  # noqa: N818 - it never leaves this module, where it becomes a value
    def __init__(self, reason: RowReason, message: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True, slots=True)
class _ReadRow:
    line_number: int
    text: str
    measurement: Measurement


def read_ground_truth(text: str, *, now_unix_s: float) -> GroundTruth:
    """Return the measurements that a CSV text holds, and the rows that are refused.

    Args:
        text: With a header; its columns in any order.
        now_unix_s: What is measured later is refused.

    Raises:
        GroundTruthError: There is no header, or it has other columns than `COLUMNS` and perhaps a note.
    """
    lines = _LINE_END.split(text.removeprefix("\ufeff"))
    numbered = [(number, line) for number, line in enumerate(lines, start=1) if line.strip(" \t;,")]
    if not numbered:
        raise GroundTruthError(f"the table is empty; its first line shall be {','.join(COLUMNS)}")
    header = numbered[0][1]
    delimiter = ";" if header.count(";") > header.count(",") else ","
    columns = _columns(header, delimiter)
    rows: list[_ReadRow] = []
    refused: list[RefusedRow] = []
    for number, line in numbered[1:]:
        try:
            cells = _cells(line, columns, delimiter=delimiter)
            rows.append(_ReadRow(number, line, _measurement(cells, now_unix_s=now_unix_s)))
        except _RowRefusal as refusal:
            refused.append(RefusedRow(number, refusal.reason, str(refusal), line))
    first, repeated = _first_of_each(rows)
    kept, contradicted = _without_contradictions(first)
    return GroundTruth(
        measurements=tuple(sorted((row.measurement for row in kept), key=_order)),
        refused=tuple(sorted([*refused, *repeated, *contradicted], key=lambda row: row.line_number)),
    )


def text_of_table(content: bytes) -> str:
    """Return the text of a file, in UTF-8 or, where it is none, as older Windows programs write it.

    Raises:
        GroundTruthError: It is neither.
    """
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        pass
    try:
        return content.decode("cp1252")
    except UnicodeDecodeError as error:
        raise GroundTruthError("the table is neither UTF-8 nor Windows-1252 text; export it as UTF-8") from error


def canonical_csv(measurements: Sequence[Measurement]) -> str:
    """Return measurements as the one text that says them: sorted, with commas, points and UTC."""
    written = io.StringIO()
    rows = csv.writer(written, lineterminator="\n")
    rows.writerow([*COLUMNS, NOTE_COLUMN])
    for each in sorted(measurements, key=_order):
        moments = [_utc_text(each.from_unix_s), _utc_text(each.until_unix_s)]
        rows.writerow([each.section_id, *moments, repr(each.mu), repr(each.mu_sd), each.instrument, each.note])
    return written.getvalue()


def ground_truth_digest(measurements: Sequence[Measurement]) -> str:
    """Return sixteen hexadecimal characters that name measurements, whatever the order and writing of their rows."""
    return hashlib.sha256(canonical_csv(measurements).encode()).hexdigest()[:16]


def refused_csv(refused: Sequence[RefusedRow]) -> str:
    """Return refused rows as a CSV text, for whoever has to mend them."""
    written = io.StringIO()
    rows = csv.writer(written, lineterminator="\n")
    rows.writerow(["line_number", "reason", "message", "row"])
    rows.writerows([row.line_number, row.reason.value, row.message, row.text] for row in refused)
    return written.getvalue()


def _columns(header: str, delimiter: str) -> tuple[str, ...]:
    try:
        names = tuple(cell.strip().lower() for cell in _split(header, delimiter))
    except csv.Error as error:
        raise GroundTruthError(f"the header cannot be read: {error}") from error
    while names and not names[-1]:
        names = names[:-1]
    missing = [name for name in COLUMNS if name not in names]
    unknown = sorted(set(names) - {*COLUMNS, NOTE_COLUMN})
    if missing or unknown or len(set(names)) < len(names):
        problem = f"lacks {', '.join(missing)}" if missing else "holds a column twice"
        problem = f"holds unknown {', '.join(map(repr, unknown))!s:.200}" if unknown and not missing else problem
        raise GroundTruthError(f"the header {problem}; it shall be {','.join(COLUMNS)} and may hold {NOTE_COLUMN}")
    return names


def _split(line: str, delimiter: str) -> list[str]:
    return next(csv.reader([line], delimiter=delimiter, strict=True, skipinitialspace=True), [])


def _cells(line: str, columns: Sequence[str], *, delimiter: str) -> dict[str, str]:
    try:
        cells = [cell.strip() for cell in _split(line, delimiter)]
    except csv.Error as error:
        raise _RowRefusal(RowReason.MALFORMED, f"the row cannot be read: {error}") from error
    # Spreadsheets leave out or add empty cells at the end of a row.
    while len(cells) > len(columns) and not cells[-1]:
        cells.pop()
    if len(cells) == len(columns) - 1 and columns[-1] == NOTE_COLUMN:
        cells.append("")
    if len(cells) != len(columns):
        raise _RowRefusal(RowReason.MALFORMED, f"{len(cells)} cells under {len(columns)} columns")
    return dict(zip(columns, cells, strict=True))


def _measurement(cells: Mapping[str, str], *, now_unix_s: float) -> Measurement:
    for name in COLUMNS:
        if not cells[name]:
            raise _RowRefusal(RowReason.MISSING, f"{name} is blank")
    for name in ("instrument", NOTE_COLUMN):
        word = cells.get(name, "")
        if len(word) > _TEXT_LIMIT_CHARS or not word.isprintable():
            raise _RowRefusal(
                RowReason.MALFORMED, f"{name} has unprintable characters, or more than {_TEXT_LIMIT_CHARS}"
            )
    if not _SECTION.fullmatch(cells["section_id"]):
        told = f"{cells['section_id']!r:.60} is no section: 1 to 48 lower-case letters, digits and hyphens"
        raise _RowRefusal(RowReason.NOT_A_SECTION, told)
    from_unix_s, until_unix_s = _moment_unix_s(cells, "from_utc"), _moment_unix_s(cells, "until_utc")
    _check_span(from_unix_s, until_unix_s, now_unix_s=now_unix_s)
    return Measurement(
        section_id=cells["section_id"],
        from_unix_s=from_unix_s,
        until_unix_s=until_unix_s,
        mu=_number(cells, "mu", MU_RANGE),
        mu_sd=_number(cells, "mu_sd", MU_SD_RANGE),
        instrument=cells["instrument"],
        note=cells.get(NOTE_COLUMN, ""),
    )


def _moment_unix_s(cells: Mapping[str, str], name: str) -> float:
    word = cells[name]
    try:
        moment = datetime.fromisoformat(word)
        if moment.tzinfo is None:
            raise _RowRefusal(RowReason.NOT_A_TIME, f"{name} {word} names no zone; end it with Z for UTC")
        unix_s = round(moment.timestamp(), 3)
    except (ValueError, OverflowError) as error:
        told = f"{name} {word!r:.60} is no time such as 2026-01-31T06:30:00Z"
        raise _RowRefusal(RowReason.NOT_A_TIME, told) from error
    if unix_s < EARLIEST_UNIX_S:
        raise _RowRefusal(RowReason.OUT_OF_RANGE, f"{name} {word} lies before the year 2000")
    return unix_s


def _check_span(from_unix_s: float, until_unix_s: float, *, now_unix_s: float) -> None:
    if until_unix_s <= from_unix_s:
        raise _RowRefusal(RowReason.EMPTY_SPAN, "until_utc is not after from_utc")
    if until_unix_s > now_unix_s:
        raise _RowRefusal(RowReason.FUTURE, "the span ends in the future; is the zone right?")
    if until_unix_s - from_unix_s > SPAN_LIMIT_S:
        hours = (until_unix_s - from_unix_s) / 3600.0
        raise _RowRefusal(RowReason.LONG_SPAN, f"a span of {hours:.0f} hours; friction changes within a day")


def _number(cells: Mapping[str, str], name: str, limits: tuple[float, float]) -> float:
    word = cells[name]
    if not _NUMBER.fullmatch(word):
        raise _RowRefusal(RowReason.NOT_A_NUMBER, f"{name} {word!r:.60} is no number")
    number, (low, high) = float(word.replace(",", ".")), limits
    if not low <= number <= high:
        perhaps = "; is it per cent?" if number > high else ""
        raise _RowRefusal(RowReason.OUT_OF_RANGE, f"{name} {number:g} is not within {low:g} to {high:g}{perhaps}")
    return number


def _first_of_each(rows: Sequence[_ReadRow]) -> tuple[list[_ReadRow], list[RefusedRow]]:
    """Return rows that say something for the first time, and those that say it again."""
    first: dict[tuple[object, ...], _ReadRow] = {}
    repeated = []
    for row in rows:
        said = _order(row.measurement)[:-1]  # whatever was noted beside it
        if said in first:
            message = f"says the same as line {first[said].line_number}"
            repeated.append(RefusedRow(row.line_number, RowReason.DUPLICATE, message, row.text))
        else:
            first[said] = row
    return list(first.values()), repeated


def _without_contradictions(rows: Sequence[_ReadRow]) -> tuple[list[_ReadRow], list[RefusedRow]]:
    """Return rows that nothing contradicts, and those that contradict each other: nobody knows which one is right."""
    against: dict[int, int] = {}
    ordered = sorted(rows, key=lambda row: _order(row.measurement))
    for _, group in groupby(ordered, key=lambda row: row.measurement.section_id):
        of_section = list(group)
        for i, row in enumerate(of_section):
            for later in of_section[i + 1 :]:
                if later.measurement.from_unix_s >= row.measurement.until_unix_s:
                    break
                if _contradict(row.measurement, later.measurement):
                    against.setdefault(row.line_number, later.line_number)
                    against.setdefault(later.line_number, row.line_number)
    refused = [
        RefusedRow(
            row.line_number,
            RowReason.CONTRADICTION,
            f"says {row.measurement.mu:g} where line {against[row.line_number]} says otherwise, by more than their "
            "uncertainties allow",
            row.text,
        )
        for row in rows
        if row.line_number in against
    ]
    return [row for row in rows if row.line_number not in against], refused


def _contradict(one: Measurement, other: Measurement) -> bool:
    return abs(one.mu - other.mu) > CONTRADICTION_SDS_RATIO * hypot(one.mu_sd, other.mu_sd)


def _order(each: Measurement) -> tuple[str, float, float, str, float, float, str]:
    return (
        each.section_id,
        each.from_unix_s,
        each.until_unix_s,
        each.instrument,
        each.mu,
        each.mu_sd,
        each.note,
    )


def _utc_text(unix_s: float) -> str:
    moment = datetime.fromtimestamp(unix_s, UTC)
    digits = "milliseconds" if moment.microsecond else "seconds"
    return moment.isoformat(timespec=digits).replace("+00:00", "Z")
