"""A program for the kill test: ingests passages without end and prints the id of each acknowledged one."""

from __future__ import annotations

import asyncio
import os
import sys
from dataclasses import replace
from pathlib import Path

from roadgrip.features import NEWEST_TABLE
from roadgrip.records import Accepted, Passage
from rsu_app.adapters.clocks import SystemClock
from rsu_app.adapters.store import open_store
from rsu_app.usecases import RoadSideUnit
from tests.rsu_app.fakes import FakeModel, make_passage, make_section

SENDERS_COUNT = 200
SECTION = make_section()
TEMPLATE = make_passage(SECTION)
KURTOSIS = [f.name for f in NEWEST_TABLE.kinematic].index("steer_kurtosis")


def numbered_passage(number: int) -> Passage:
    """A passage of its own for every number below a million, made fast enough to keep the writer under pressure."""
    values = list(TEMPLATE.summary.values)
    values[KURTOSIS] = 2.0 + number * 1e-5
    return replace(
        TEMPLATE,
        passage_id=number.to_bytes(16, "big"),
        summary=replace(TEMPLATE.summary, values=tuple(values)),
    )


async def main(database_path: Path, first_number: int) -> None:
    unit = RoadSideUnit(sections=[SECTION], store=open_store(database_path), model=FakeModel(), clock=SystemClock())

    async def send(number: int) -> None:
        while True:
            passage = numbered_passage(number)
            number += SENDERS_COUNT
            outcome = await unit.ingest_passage(passage)
            if outcome != Accepted():
                raise SystemExit(f"{outcome}")
            # One write call per line: the parent never reads half of one that was completed.
            os.write(1, f"{passage.passage_id.hex()}\n".encode())

    await asyncio.gather(*(send(first_number + sender) for sender in range(SENDERS_COUNT)))


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), int(sys.argv[2])))
