"""A program for the kill test: ingests passages without end and prints the id of each acknowledged one."""

from __future__ import annotations

import asyncio
import os
import sys
from pathlib import Path

from roadgrip.records import Accepted
from rsu_app.adapters.clocks import SystemClock
from rsu_app.adapters.store import open_store
from rsu_app.usecases import RoadSideUnit
from tests.rsu_app.fakes import FakeModel, make_passage, make_section

SENDERS_COUNT = 16


async def main(database_path: Path, first_seed: int) -> None:
    section = make_section()
    unit = RoadSideUnit(sections=[section], store=open_store(database_path), model=FakeModel(), clock=SystemClock())
    await unit.restore()

    async def send(seed: int) -> None:
        while True:
            passage = make_passage(section, seed=seed)
            seed += SENDERS_COUNT
            if await unit.ingest_passage(passage) == Accepted():
                # One write call per line: the parent never reads half of one that was completed.
                os.write(1, f"{passage.passage_id.hex()}\n".encode())

    await asyncio.gather(*(send(first_seed + sender) for sender in range(SENDERS_COUNT)))


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), int(sys.argv[2])))
