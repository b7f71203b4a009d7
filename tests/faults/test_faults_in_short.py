"""The faults of `make faults`, each once or a few times: enough to see that the unit and the harness still know "
"them."""

import random
import tempfile
from pathlib import Path

import pytest

from tests.faults import damage, kills
from tests.faults.__main__ import PAGE, RESULTS
from tests.faults.disks import FULL, READ_ONLY, READS_FAIL, SYNCS_FAIL, WRITES_FAIL
from tests.faults.machine import Machine, can_be_made
from tests.faults.matrix import SCENARIOS
from tests.faults.matrix_page import page_with, read
from tests.faults.power_cut import boundaries, cuts, restore
from tests.faults.remains import judge, opened, remains_of
from tests.faults.scenario import Finding, Stage
from tests.faults.stores import store_alone
from tests.faults.units import DATABASE_NAME
from tests.rsu_app.adapters.store.stories import make_entry

pytestmark = [
    pytest.mark.system,
    pytest.mark.xdist_group("faults"),  # one process that others are forked from
    pytest.mark.skipif(not can_be_made(), reason="the disk that fails is compiled with gcc, which is not here"),
]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "unit").mkdir()
    return tmp_path / "unit"


def ids_of(seeds):
    return [make_entry(seed).passage.passage_id for seed in seeds]


@pytest.mark.parametrize("fault", [FULL, READ_ONLY, WRITES_FAIL, SYNCS_FAIL], ids=["full", "read-only", "EIO", "fsync"])
def test_a_disk_that_fails_refuses_passages_and_loses_none(folder, tmp_path, fault):
    machine = Machine(folder, tmp_path)
    with store_alone(machine) as store:
        assert store.append(range(10)) == ""
        machine.set(**fault.control)
        assert store.append(range(10, 20))
        assert store.probe()
        machine.whole()
        assert store.append(range(20, 30)) == ""
        assert store.append(range(10, 20)) == "", "what was refused may come again"
        assert store.probe() == ""
    left = remains_of(folder / DATABASE_NAME)
    assert set(left.ids) == set(ids_of(range(30)))
    assert (left.repeated_count, left.problems) == (0, ())


def test_a_disk_that_cannot_be_read_for_a_moment_is_not_taken_for_damaged(folder, tmp_path):
    machine = Machine(folder, tmp_path)
    with store_alone(machine) as store:
        assert store.append(range(10)) == ""
        machine.set(**READS_FAIL.control)
        store.append(range(10, 20))
        machine.whole()
        assert store.append(range(20, 30)) == ""
    assert set(ids_of([*range(10), *range(20, 30)])) <= set(remains_of(folder / DATABASE_NAME).ids)
    assert not list(folder.glob("*.damaged-*"))


def cut_and_look(folder, tmp_path, *, broken="", failed_syncs=False):
    """Return what forty power cuts leave of a store that was written to."""
    machine = Machine(folder, tmp_path, recorded=True)
    chance = random.Random(5)
    told: dict[bytes, int] = {}
    with store_alone(machine, broken=broken) as store:
        for number in range(24):
            seeds = range(4 * number, 4 * number + 4)
            if failed_syncs and number == 8:
                machine.set(sync_errno=5)
                assert store.append(seeds)
                # Sent again at once, as vehicles do.
                told |= {} if store.append(seeds) else dict.fromkeys(ids_of(seeds), machine.recorded_bytes)
                machine.whole()
            assert store.append(seeds) == ""
            told = dict.fromkeys(ids_of(seeds), machine.recorded_bytes) | told
    log = machine.log_path.read_bytes()
    found = Finding()
    for moment, files in cuts(log, [chance.choice(boundaries(log)) for _ in range(40)], chance=chance):
        with tempfile.TemporaryDirectory() as place:
            restore(files, folder=machine.folder, into=Path(place), beginning=DATABASE_NAME)
            judge(found, opened(Path(place, DATABASE_NAME)), [known for known, at in told.items() if at <= moment])
        found.runs_count += 1
    return found


def test_a_power_cut_takes_nothing_acknowledged(folder, tmp_path):
    assert cut_and_look(folder, tmp_path).passed


@pytest.mark.parametrize("broken", ["synchronous = NORMAL", "synchronous = OFF"])
def test_a_power_cut_takes_acknowledged_passages_of_a_store_that_does_not_wait_for_the_disk(folder, tmp_path, broken):
    assert cut_and_look(folder, tmp_path, broken=broken).lost_count > 0


def test_nothing_is_built_on_what_a_failed_fsync_left_in_memory(folder, tmp_path):
    assert cut_and_look(folder, tmp_path, failed_syncs=True).passed


def test_it_would_be_noticed_if_something_were(folder, tmp_path):
    broken = "the log is read back after a failure"
    assert cut_and_look(folder, tmp_path, broken=broken, failed_syncs=True).lost_count > 0


@pytest.mark.parametrize(("perform", "runs_count"), [(kills.kills_under_load, 2), (damage.damaged_in_service, 1)])
def test_a_real_unit_under_load_keeps_its_promise(tmp_path, perform, runs_count):
    found = perform(Stage(tmp_path, seed=1, runs_count=runs_count))
    assert found.problems == []
    assert found.passed


@pytest.mark.long
@pytest.mark.timeout(1_800)
@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.name)
def test_every_scenario_keeps_its_promise_once(tmp_path, scenario):
    found = scenario.perform(Stage(tmp_path, seed=2, runs_count=min(scenario.runs_count, 10)))
    assert found.problems == []
    assert found.passed


def test_the_page_tells_what_the_figures_say():
    page = PAGE.read_text(encoding="utf-8")
    assert page_with(page, read(RESULTS)) == page, "make faults"


def test_every_scenario_can_be_broken_and_has_a_name_of_its_own():
    assert len({scenario.name for scenario in SCENARIOS}) == len(SCENARIOS)
    assert all(scenario.controls for scenario in SCENARIOS)
