import doctest
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip import units


def test_the_examples_in_the_docstring_are_true():
    assert doctest.testmod(units).failed == 0


@given(st.floats(0.0, 400.0))
def test_speeds_survive_the_way_to_a_person_and_back(speed):
    assert units.kph_to_mps(units.mps_to_kph(speed)) == pytest.approx(speed)


def test_known_conversions():
    assert units.mps_to_kph(1.0) == pytest.approx(3.6)
    assert units.deg_to_rad(180.0) == pytest.approx(math.pi)


def test_a_sample_is_one_period_of_the_rate():
    assert pytest.approx(1.0) == units.SAMPLE_S * units.SAMPLE_RATE_HZ
