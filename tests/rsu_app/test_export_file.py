from __future__ import annotations

import gzip
from dataclasses import replace
from random import Random

import numpy as np
import pytest

from roadgrip.passage_export import ExportedPassage, ExportHead, head_from_json, passage_from_json
from rsu_app import export_file
from rsu_app.export_file import ExportFailedError, shuffled, step_before, write_export

HEAD = ExportHead(
    unit="fv27",
    exported_unix_s=1_767_268_800.5,
    since_unix_s=0.0,
    until_unix_s=1_767_268_800.0,
    sections_json={"0123456789abcdef": "{}"},
    bundle_id="dd1ff2271c966bec",
    ledger_hash="0" * 64,
    software="1.0",
)


def passage(number: int, *, left_unix_s: float = 0.0, section_id: str = "bend") -> ExportedPassage:
    return ExportedPassage(
        section_id=section_id,
        map_version="0123456789abcdef",
        table_digest="1b7bc963ba3dd63c",
        values=np.arange(3, dtype=np.float32) + np.float32(number / 7),
        duration_s=float(number),
        quality=4,
        left_unix_s=left_unix_s,
        bundle_id="dd1ff2271c966bec",
        mu=0.1,
        flags=0,
        expected_error_ratio=None,
        mu_low=None,
        at_least=False,
        shadow_bundle_id=None,
        shadow_mu=None,
    )


def lines_of(path):
    with gzip.open(path, "rt", encoding="utf-8") as file:
        return file.read().splitlines()


def numbers_of(passages):
    return [int(each.duration_s) for each in passages]


def test_what_was_written_is_read_back(tmp_path):
    path = tmp_path / "export.ndjson.gz"
    told = [passage(number, left_unix_s=10.0 * number) for number in range(5)]
    counts: list[int] = []
    assert write_export(path, HEAD, told, rng=Random(1), on_written=counts.append) == 5
    head, *lines = lines_of(path)
    assert head_from_json(head) == HEAD
    found = [passage_from_json(line) for line in lines]
    assert numbers_of(found) == [0, 1, 2, 3, 4]
    assert all(np.array_equal(one.values, other.values) for one, other in zip(found, told, strict=True))
    assert counts == [1, 2, 3, 4, 5]


def test_an_export_without_passages_has_its_head(tmp_path):
    path = tmp_path / "export.ndjson.gz"
    assert write_export(path, HEAD, [], rng=Random(1)) == 0
    assert len(lines_of(path)) == 1


def test_an_export_says_nothing_but_its_lines(tmp_path):
    # gzip keeps a file's name and time unless it is told not to.
    one, other = tmp_path / "one.gz", tmp_path / "other.gz"
    for path in (one, other):
        write_export(path, HEAD, [passage(1)], rng=Random(1))
    assert one.read_bytes() == other.read_bytes()


def test_only_the_account_that_writes_an_export_may_read_it(tmp_path):
    path = tmp_path / "export.ndjson.gz"
    write_export(path, HEAD, [], rng=Random(1))
    assert path.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError, OSError])
@pytest.mark.parametrize("before", [None, b"the export of yesterday"])
def test_an_interrupted_export_leaves_what_was_there(tmp_path, error, before):
    path = tmp_path / "export.ndjson.gz"
    if before is not None:
        path.write_bytes(before)

    def cut_off():
        for number in range(500):
            yield passage(number, left_unix_s=10.0 * number)
        raise error("no more")

    with pytest.raises((error, ExportFailedError)):
        write_export(path, HEAD, cut_off(), rng=Random(1))
    assert [file.read_bytes() for file in tmp_path.iterdir()] == ([] if before is None else [before])


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ExportFailedError, match=r"nowhere/export\.ndjson\.gz"):
        write_export(tmp_path / "nowhere" / "export.ndjson.gz", HEAD, [], rng=Random(1))


def test_the_order_within_a_step_of_time_is_chance_and_between_steps_is_kept():
    told = [passage(number, left_unix_s=10.0 * (number // 20)) for number in range(60)]
    one, other = (numbers_of(shuffled(told, rng=Random(seed))) for seed in (1, 2))
    assert one != other
    for first in (0, 20, 40):
        assert sorted(one[first : first + 20]) == list(range(first, first + 20)) != one[first : first + 20]


def test_sections_are_not_mixed():
    told = [passage(number, section_id="abc"[number // 4]) for number in range(12)]
    assert [each.section_id for each in shuffled(told, rng=Random(1))] == list("aaaabbbbcccc")


def test_however_many_leave_at_once_none_is_lost(monkeypatch):
    monkeypatch.setattr(export_file, "SHUFFLED_COUNT", 4)
    told = [passage(number) for number in range(10)]
    assert sorted(numbers_of(shuffled(told, rng=Random(1)))) == list(range(10))


def test_shuffling_holds_one_step_of_time_at_most():
    taken: list[int] = []

    def coming():
        for number in range(100):
            taken.append(number)
            yield replace(passage(number), left_unix_s=10.0 * (number // 5))

    passages = shuffled(coming(), rng=Random(1))
    for _ in range(6):
        next(passages)
    assert len(taken) <= 11


@pytest.mark.parametrize(("unix_s", "step_unix_s"), [(0.0, 0.0), (9.9, 0.0), (10.0, 10.0), (1e9 + 7.0, 1e9)])
def test_a_bound_is_a_step_of_time(unix_s, step_unix_s):
    assert step_before(unix_s) == step_unix_s
