from __future__ import annotations

import gzip
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.passage_export import ExportError, passage_to_json
from tests.training.data.exports import BEND, export_text, exported, head_of, write_export
from training.data.exported_passages import PassageReason, read_export


def test_an_export_is_read_compressed_or_not(tmp_path):
    passages = [exported(seed) for seed in range(3)]
    plain = read_export(write_export(tmp_path / "a.jsonl", passages))
    packed = read_export(write_export(tmp_path / "a.jsonl.gz", passages))
    assert plain.head == packed.head == head_of(BEND)
    assert plain.digest == packed.digest
    for export in (plain, packed):
        assert list(export.passages) == [2, 3, 4]
        assert [each.values.tolist() for each in export.passages.values()] == [
            each.values.tolist() for each in passages
        ]
        assert export.refused == ()


def test_another_text_has_another_digest(tmp_path):
    first = read_export(write_export(tmp_path / "a.jsonl", [exported(0)]))
    second = read_export(write_export(tmp_path / "b.jsonl", [exported(1)]))
    assert first.digest != second.digest


def test_a_line_that_holds_no_passage_is_refused_with_its_number(tmp_path):
    path = tmp_path / "a.jsonl"
    huge = json.dumps({**json.loads(passage_to_json(exported(1))), "left_unix_s": 10**400})
    lines = ["{}", passage_to_json(exported(0)), "", "\udcff", huge, "[" * 100_000]
    path.write_bytes((export_text([]) + "\n".join(lines)).encode(errors="surrogateescape"))
    export = read_export(path)
    assert list(export.passages) == [3]
    assert [(each.export, each.line_number, each.reason) for each in export.refused] == [
        ("a.jsonl", number, PassageReason.MALFORMED) for number in (2, 5, 6, 7)
    ]


@pytest.mark.parametrize("content", [b"", b"{}\n", b"\x1f\x8b", b"section_id,from_utc\n", b"\xff\xfe\n"])
def test_what_is_no_export_is_refused_with_its_place(tmp_path, content):
    path = tmp_path / "a.jsonl"
    path.write_bytes(content)
    with pytest.raises(ExportError, match=r"a\.jsonl"):
        read_export(path)


def test_an_export_that_was_cut_short_is_refused(tmp_path):
    path = write_export(tmp_path / "a.jsonl.gz", [exported(seed) for seed in range(20)])
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ExportError, match="cut short or damaged"):
        read_export(path)


@given(content=st.binary(max_size=200), packed=st.booleans(), with_head=st.booleans())
def test_any_bytes_give_an_export_or_an_error_of_ours(tmp_path_factory, content, packed, with_head):
    path = tmp_path_factory.mktemp("any") / "a.jsonl"
    whole = (export_text([]).encode() if with_head else b"") + content
    path.write_bytes(gzip.compress(whole) if packed else whole)
    try:
        export = read_export(path)
    except ExportError:
        assert not with_head
        return
    assert with_head
    assert all(each.line_number >= 2 for each in export.refused)
