"""Records of runs with mlflow, in a file of our own: nothing is lost, nothing is sent anywhere."""

import os
import shutil
import sqlite3
from contextlib import closing
from typing import Any

import pytest

from roadgrip.errors import ConfigurationError
from tests.training.study.fake_chapters import fake_chapter, fake_result, verdict
from training.report.small_files import write_chapter
from training.study.finding import Computed, Finding, Timing
from training.study_show import StudyRecord
from training.tracking import DATABASE_FILE_NAME, ModelRegister, TrackedRun, Tracker, local_address, local_tracker
from vehicle_client.simulator.plan import SensorGrade

# Tables are made the first time, which takes seconds: one set of records for all tests.
pytestmark = [pytest.mark.xdist_group("tracking"), pytest.mark.timeout(180)]


class Records:
    """Records of a study, read without the library that wrote them."""

    def __init__(self, folder, tracker: Tracker) -> None:
        self.folder = folder
        self.tracker = tracker

    def ask(self, question: str, *values: str) -> list[tuple[Any, ...]]:
        with closing(sqlite3.connect(self.folder / DATABASE_FILE_NAME)) as database:
            return database.execute(question, values).fetchall()


@pytest.fixture(scope="session")
def records(empty_records, tmp_path_factory) -> Records:
    folder = tmp_path_factory.mktemp("records")
    shutil.copy(empty_records, folder / DATABASE_FILE_NAME)
    return Records(folder, local_tracker(folder, experiment="study"))


def test_a_run_holds_parameters_figures_words_and_files(records, tmp_path):
    run = records.tracker.begin("one", parameters={"seed": 3, "text": "x" * 10_000}, began_ago_s=60.0)
    run.metrics({"headline.best.mape": 0.02, "undefined": float("nan")})
    run.word("claim", "confirmed")
    (tmp_path / "table.csv").write_text("a\n1\n", encoding="utf-8")
    run.file(tmp_path / "table.csv")
    run.end()
    one = run.run_id
    assert records.ask("select value from params where run_uuid = ? and key = 'seed'", one) == [("3",)]
    assert records.ask("select key, value from metrics where run_uuid = ?", one) == [("headline.best.mape", 0.02)]
    assert records.ask("select value from tags where run_uuid = ? and key = 'claim'", one) == [("confirmed",)]
    ((status, took_ms, place),) = records.ask(
        "select status, end_time - start_time, artifact_uri from runs where run_uuid = ?", one
    )
    assert status == "FINISHED"
    assert 60_000 <= took_ms < 600_000
    assert place.startswith(records.folder.as_uri())
    assert [path.name for path in records.folder.rglob("table.csv")] == ["table.csv"]


def test_a_run_keeps_folders_and_says_which_data_it_took(records, tmp_path):
    run = records.tracker.begin("with folders", parameters={})
    (tmp_path / "plots").mkdir()
    (tmp_path / "plots" / "one.svg").write_text("<svg/>", encoding="utf-8")
    run.folder(tmp_path / "plots", "pictures")
    run.file(tmp_path / "plots" / "one.svg", folder="more")
    run.data_set("winter", digest="0123", source="a trailer", profile="{}")
    run.end()
    kept = {
        path.relative_to(records.folder).as_posix().split("artifacts/")[1] for path in records.folder.rglob("one.svg")
    }
    assert kept == {"pictures/one.svg", "more/one.svg"}
    taken = (
        "select d.name, d.digest from datasets d join inputs i on i.source_id = d.dataset_uuid "
        "where i.destination_id = ?"
    )
    assert records.ask(taken, run.run_id) == [("winter", "0123")]


def test_a_run_of_before_can_be_given_more(records, tmp_path):
    run = records.tracker.begin("before", parameters={})
    run.end()
    register = ModelRegister(address=local_address(records.folder))
    register.run(run.run_id).word("gate", "passed")
    assert records.ask("select value from tags where run_uuid = ? and key = 'gate'", run.run_id) == [("passed",)]
    assert not register.fetch(run.run_id, "bundle", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_versions_count_up_and_an_alias_points_to_one(records):
    register = ModelRegister(address=local_address(records.folder))
    assert (register.versions("a model"), register.aliases("a model")) == ([], {})
    for word in ("first", "second"):
        run = records.tracker.begin(word, parameters={})
        made = register.add("a model", run_id=run.run_id, words={"word": word}, description=word)
        assert (made.run_id, made.words) == (run.run_id, {"word": word})
        run.end()
    assert [version.version for version in register.versions("a model")] == [2, 1]
    register.set_alias("a model", "challenger", 1)
    register.set_alias("a model", "challenger", 2)
    register.say("a model", 2, {"gate": "passed"})
    assert register.aliases("a model") == {"challenger": 2}
    assert register.versions("a model")[0].words == {"word": "second", "gate": "passed"}
    assert register.versions("another model") == []


def test_a_study_is_a_run_with_a_run_for_each_chapter_and_grade(records, tmp_path):
    computed = {grade: Computed(fake_result(), Timing(1.0, 2.0), "abc", {"paper ideal": "d"}) for grade in SensorGrade}
    finding = Finding(fake_chapter("a"), computed, verdict({SensorGrade.IDEAL: fake_result()}))
    told: list[str] = []
    record = StudyRecord(records.tracker, "study paper", {"quick": True}, tell=told.append)
    record.chapter(finding, write_chapter(finding, tmp_path))
    record.end((), well=False)
    ((parent,),) = records.ask("select run_uuid from runs where name = 'study paper' and status = 'FAILED'")
    children = records.ask("select run_uuid from tags where key = 'mlflow.parentRunId' and value = ?", parent)
    names = {
        name for (child,) in children for (name,) in records.ask("select name from runs where run_uuid = ?", child)
    }
    assert names == {"a ideal", "a automotive"}
    sizes = "select value from params where run_uuid = ? and key = 'size.rows_count'"
    assert records.ask(sizes, children[0][0]) == [("60",)]
    quick = "select value from params where run_uuid = ? and key = 'quick'"
    assert records.ask(quick, children[0][0]) == records.ask(quick, parent) == [("True",)]
    assert told == []


class GoneAfterOneRun(Tracker):
    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self._asked_count = 0

    def begin(self, name: str, **options: Any) -> TrackedRun:
        self._asked_count += 1
        if self._asked_count > 1:
            raise ConfigurationError("cannot record at nowhere")
        return self._tracker.begin(name, **options)


def test_a_study_goes_on_when_its_records_are_gone(records):
    told: list[str] = []
    record = StudyRecord(GoneAfterOneRun(records.tracker), "study paper", {}, tell=told.append)
    computed = {SensorGrade.IDEAL: Computed(fake_result(), Timing(1.0, 2.0), "abc", {})}
    for _ in range(2):
        record.chapter(Finding(fake_chapter("a"), computed, None), ())
    record.end((), well=True)
    assert told == ["cannot record at nowhere; the study goes on without records"]


def test_a_place_that_cannot_be_recorded_at_is_named(tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="cannot record at sqlite"):
        Tracker(address=f"sqlite:///{tmp_path}/file/mlflow.db", experiment="study")


def test_the_library_tells_nobody(records):
    assert records.tracker is not None
    assert os.environ["MLFLOW_DISABLE_TELEMETRY"] == "true"
