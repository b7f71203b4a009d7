from rsu_app.latest_refusals import LatestRefusals


def refuse(latest: LatestRefusals, reason: str, *, now_s: float, section: str = "bend", detail: str = "") -> None:
    latest.note(reason=reason, section=section, via="udp", detail=detail, now_s=now_s)


def test_refusals_of_one_kind_are_told_together_with_what_was_found_last():
    latest = LatestRefusals()
    refuse(latest, "stale_map", now_s=1.0, detail="the first")
    refuse(latest, "unsigned", now_s=2.0)
    refuse(latest, "stale_map", now_s=3.0, detail="the second")
    newest, older = latest.newest()
    assert (newest.reason, newest.refused_count, newest.at_s, newest.detail) == ("stale_map", 2, 3.0, "the second")
    assert older.reason == "unsigned"


def test_a_flood_of_one_kind_pushes_out_no_other():
    latest = LatestRefusals(kinds_limit_count=2)
    refuse(latest, "stale_map", now_s=0.0)
    for n in range(1000):
        refuse(latest, "malformed", now_s=float(n))
    assert [each.reason for each in latest.newest()] == ["malformed", "stale_map"]


def test_the_kind_that_was_not_seen_for_longest_makes_room():
    latest = LatestRefusals(kinds_limit_count=2)
    for now_s, section in enumerate(["a", "b", "a", "c"]):
        refuse(latest, "stale_map", now_s=float(now_s), section=section)
    assert [each.section for each in latest.newest()] == ["c", "a"]


def test_what_a_sender_has_a_hand_in_is_cut():
    latest = LatestRefusals()
    refuse(latest, "malformed", now_s=0.0, detail="x" * 10_000)
    assert len(latest.newest()[0].detail) <= 200
