from __future__ import annotations

import dataclasses
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.ledger import (
    GENESIS_HASH,
    TEXT_LIMIT_CHARS,
    Action,
    LedgerEntry,
    LedgerError,
    chain_problems,
    entry_after,
    entry_from_json,
    entry_to_json,
    provenance_at,
)


def chain(*acts: tuple[Action, str], step_s: float = 60.0) -> list[LedgerEntry]:
    entries: list[LedgerEntry] = []
    for number, (action, subject) in enumerate(acts):
        before = entries[-1] if entries else None
        entries.append(
            entry_after(before, at_unix_s=number * step_s, actor="ann", action=action, subject=subject, reason="why")
        )
    return entries


FIVE = chain(*[(Action.PROMOTED, f"{number:016x}") for number in range(5)])


def test_entries_follow_each_other_from_the_first_one_on():
    assert [entry.sequence_number for entry in FIVE] == [1, 2, 3, 4, 5]
    assert FIVE[0].previous_hash == GENESIS_HASH
    assert chain_problems(FIVE) == []


@pytest.mark.parametrize(
    "change",
    [
        {"at_unix_s": 1.0},
        {"actor": "bob"},
        {"action": Action.ROLLED_BACK},
        {"subject": "f" * 16},
        {"reason": "another"},
        {"evidence": {"gate": "passed"}},
        {"previous_hash": "0" * 63 + "1"},
    ],
)
def test_an_entry_that_was_changed_is_found(change):
    assert chain_problems([*FIVE[:2], dataclasses.replace(FIVE[2], **change), *FIVE[3:]])


def test_an_entry_that_was_changed_with_its_hash_breaks_the_next_one():
    forged = entry_after(
        FIVE[1], at_unix_s=120.0, actor="bob", action=Action.PROMOTED, subject="f" * 16, reason="slipped in"
    )
    assert chain_problems([*FIVE[:2], forged, *FIVE[3:]]) == ["entry 4 does not follow entry 3 as it stands"]


def test_an_entry_that_was_left_out_is_found():
    assert chain_problems([*FIVE[:2], *FIVE[3:]]) == ["entry 4 follows entry 2"]


def test_cut_off_at_the_end_it_holds_together_until_somebody_knows_an_old_head():
    assert chain_problems(FIVE[:3]) == []
    assert chain_problems(FIVE[:3], known_heads=[FIVE[2].entry_hash]) == []
    assert len(chain_problems(FIVE[:3], known_heads=[FIVE[4].entry_hash])) == 1


def test_a_budget_may_have_cut_the_beginning():
    assert chain_problems(FIVE[2:]) == []


def test_a_first_entry_that_follows_another_is_found():
    first = entry_after(None, at_unix_s=0.0, actor="a", action=Action.LIVE, subject="", reason="")
    second = entry_after(first, at_unix_s=0.0, actor="a", action=Action.LIVE, subject="", reason="")
    posing = dataclasses.replace(second, sequence_number=1)
    assert "entry 1 follows another one" in chain_problems([posing])


ACTS = st.fixed_dictionaries(
    {
        "at_unix_s": st.floats(),
        "actor": st.text(),
        "action": st.sampled_from(Action),
        "subject": st.text(),
        "reason": st.text(max_size=3 * TEXT_LIMIT_CHARS),
        "evidence": st.dictionaries(st.text(), st.text(), max_size=4),
    }
)


@given(ACTS)
def test_whatever_is_told_survives_the_way_through_json(act):
    entry = entry_after(None, **act)
    again = entry_from_json(entry_to_json(entry))
    assert again == entry
    assert chain_problems([again]) == []
    assert len(entry.reason) <= TEXT_LIMIT_CHARS


def test_a_time_just_before_zero_is_the_same_after_a_database_has_kept_it():
    entry = entry_after(None, at_unix_s=-1e-9, actor="", action=Action.LIVE, subject="", reason="")
    assert str(entry.at_unix_s) == "0.0"


@given(st.text())
def test_what_is_no_entry_is_said_so(text):
    with pytest.raises(LedgerError):
        entry_from_json(text)


@pytest.mark.parametrize("key", [field.name for field in dataclasses.fields(LedgerEntry)])
@pytest.mark.parametrize("value", [None, [], "x"])
def test_a_mangled_entry_is_refused_or_its_chain_is_broken(key, value):
    raw = json.loads(entry_to_json(FIVE[1]))
    raw[key] = value
    try:
        entry = entry_from_json(json.dumps(raw))
    except LedgerError:
        return
    assert chain_problems([FIVE[0], entry])


def test_a_moment_is_answered_by_the_bundle_that_was_live_and_its_release():
    entries = chain(
        (Action.LIVE, "factory"),
        (Action.INSTALLED, "newer"),
        (Action.SHADOWING, "newer"),
        (Action.SWITCHED, "newer"),
        (Action.ROLLED_BACK, "factory"),
    )

    def live_at(at_unix_s: float) -> tuple[str, str] | None:
        found = provenance_at(entries, at_unix_s)
        return None if found is None else (found.live.subject, found.installed.subject if found.installed else "")

    assert live_at(-1.0) is None
    assert live_at(170.0) == ("factory", "")
    assert live_at(180.0) == ("newer", "newer")
    assert live_at(1e9) == ("factory", "")
