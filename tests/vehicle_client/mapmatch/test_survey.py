"""A road made from a drive is the road that was driven."""

import numpy as np
import pytest

from roadgrip.errors import SectionError
from roadgrip.section import BankOrigin
from vehicle_client.mapmatch.driven_line import driven_line
from vehicle_client.mapmatch.survey import section_of_line

CIRCLE = driven_line(np.full(2001, 20.0), np.full(2001, 0.2))
"""Twenty seconds at 20 m/s around a circle of 100 m, to the left."""


def test_a_circle_that_was_driven_becomes_a_circle_on_the_map():
    section = section_of_line(
        CIRCLE, start_m=100.0, end_m=300.0, section_id="round", name="Round", speed_limit_mps=20.0
    )
    assert section.length_m == pytest.approx(200.0, abs=0.2)
    assert section.profile.curvature_1pm == pytest.approx(0.01, rel=0.02)


def test_nothing_is_claimed_about_bank_and_place():
    section = section_of_line(CIRCLE, start_m=0.0, end_m=150.0, section_id="round", name="Round", speed_limit_mps=20.0)
    assert section.bank_origin is BankOrigin.NONE
    assert section.anchors == ()


@pytest.mark.parametrize(("start_m", "end_m"), [(-1.0, 100.0), (100.0, 90.0), (350.0, 500.0)])
def test_a_stretch_that_was_not_driven_is_refused(start_m, end_m):
    with pytest.raises(SectionError, match="no stretch of a drive of 400 m"):
        section_of_line(CIRCLE, start_m=start_m, end_m=end_m, section_id="a", name="A", speed_limit_mps=20.0)
