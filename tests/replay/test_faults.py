"""One recorded curve, replayed with everything that goes wrong with sensors."""

import pytest

from tests.replay.faults import WITHOUT_WHEELS, ends_as, result_of
from tests.replay.ferrari import FERRARI_GEOMETRY, curve_section_and_trace
from vehicle_client.simulator.faults import Fault

AT_S = 8.0  # five seconds into the section, in the bend


@pytest.mark.parametrize("fault", Fault)
def test_every_fault_ends_as_it_should(fault):
    section, trace = curve_section_and_trace()
    result = result_of(trace, section, fault, at_s=AT_S, vehicle=FERRARI_GEOMETRY)
    assert ends_as(result, WITHOUT_WHEELS[fault]), result


def test_every_fault_has_a_result():
    assert set(WITHOUT_WHEELS) == set(Fault)
