from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsu_app.cookies import COOKIE_BYTES, PERIOD_S, Cookies

COOKIES = Cookies(b"a secret of many bytes")
EXCHANGE = b"exchange"


def cookie_at(now_s: float, host: str = "192.0.2.7", port: int = 4000, exchange_id: bytes = EXCHANGE) -> bytes:
    return COOKIES.cookie(host=host, port=port, exchange_id=exchange_id, now_s=now_s)


def fits(cookie: bytes, now_s: float, host: str = "192.0.2.7", port: int = 4000, exchange_id: bytes = EXCHANGE) -> bool:
    return COOKIES.fits(cookie, host=host, port=port, exchange_id=exchange_id, now_s=now_s)


@given(made_s=st.floats(0.0, 1e7), later_s=st.floats(0.0, PERIOD_S))
def test_a_cookie_holds_for_a_whole_period_at_least(made_s, later_s):
    assert fits(cookie_at(made_s), made_s + later_s)


@given(made_s=st.floats(0.0, 1e7))
def test_a_cookie_is_stale_two_periods_later(made_s):
    assert not fits(cookie_at(made_s), made_s + 2.0 * PERIOD_S)


@pytest.mark.parametrize(
    "other", [{"host": "192.0.2.8"}, {"port": 4001}, {"exchange_id": b"another!"}], ids=lambda other: next(iter(other))
)
def test_a_cookie_is_for_one_address_and_exchange(other):
    assert not fits(cookie_at(5.0), 5.0, **other)


def test_another_unit_makes_other_cookies():
    other = Cookies(b"another secret of many bytes")
    assert not other.fits(cookie_at(5.0), host="192.0.2.7", port=4000, exchange_id=EXCHANGE, now_s=5.0)


@pytest.mark.parametrize("cookie", [b"", b"\0" * COOKIE_BYTES, b"x" * 40])
def test_what_is_no_cookie_does_not_fit(cookie):
    assert not fits(cookie, 5.0)


def test_a_secret_that_can_be_guessed_is_refused():
    with pytest.raises(ValueError, match="16 bytes"):
        Cookies(b"short")
