import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsu_app.moments import shown_moment, unix_s_of


@given(st.integers(min_value=-(2**35), max_value=2**37))
def test_a_moment_that_is_shown_is_read_back(unix_s):
    assert unix_s_of(shown_moment(float(unix_s))) == unix_s


@pytest.mark.parametrize(
    "text", ["2026-01-31", "2026-01-31T00:00", "2026-01-31T00:00:00Z", "2026-01-31T01:00+01:00", "20260131"]
)
def test_a_moment_may_be_written_in_many_ways(text):
    assert shown_moment(unix_s_of(text)) == "2026-01-31T00:00:00Z"


@pytest.mark.parametrize("text", ["", "now", "2026-02-30", "12:00", "1767268800"])
def test_what_is_no_moment_is_refused(text):
    with pytest.raises(ValueError, match=r"."):
        unix_s_of(text)


@pytest.mark.parametrize("unix_s", [1e300, float("inf"), float("nan"), -1e18])
def test_what_no_calendar_has_is_shown_as_a_number(unix_s):
    assert shown_moment(unix_s) == f"{unix_s:g} s"
