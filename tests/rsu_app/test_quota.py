from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rsu_app.quota import HOUR_S, PassageQuota


def take(quota, number, *, now_s=0.0, certificate=b"car", section="long-turn"):
    return quota.take(certificate_id=certificate, section_id=section, passage_id=b"%d" % number, now_s=now_s)


def test_so_many_passages_an_hour_and_no_more():
    quota = PassageQuota(3)
    assert [take(quota, number) for number in range(5)] == [True, True, True, False, False]


def test_a_passage_that_is_sent_again_costs_nothing():
    quota = PassageQuota(1)
    assert [take(quota, 1, now_s=float(attempt)) for attempt in range(4)] == [True] * 4


def test_after_an_hour_there_is_room_again():
    quota = PassageQuota(1)
    assert take(quota, 1, now_s=0.0)
    assert not take(quota, 2, now_s=HOUR_S - 1.0)
    assert take(quota, 2, now_s=HOUR_S)


def test_each_section_and_each_certificate_has_its_own():
    quota = PassageQuota(1)
    assert take(quota, 1)
    assert take(quota, 2, section="s-turn")
    assert take(quota, 3, certificate=b"another car")


@given(st.lists(st.tuples(st.integers(0, 3), st.floats(0.0, 20_000.0)), max_size=60))
def test_no_hour_holds_more_than_the_quota(story):
    quota, allowed = PassageQuota(2), []
    for number, (certificate, now_s) in enumerate(sorted(story, key=lambda each: each[1])):
        if take(quota, number, certificate=b"%d" % certificate, now_s=now_s):
            allowed.append((certificate, now_s))
    for certificate, until_s in allowed:
        within = [at_s for its, at_s in allowed if its == certificate and until_s - HOUR_S < at_s <= until_s]
        assert len(within) <= 2


def test_memory_is_bounded_and_keeps_who_came_last():
    quota = PassageQuota(1, kept_count=10)
    for number in range(50):
        take(quota, number, certificate=b"%d" % number)
    assert len(quota) == 10
    assert not take(quota, 99, certificate=b"49")
