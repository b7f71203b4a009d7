"""One recorded curve, replayed with everything that goes wrong with sensors."""

import pytest

from roadgrip.records import Rejected
from tests.replay.faults import EXPECTED, Fault, Refusal, Summary, Unreadable, applied
from tests.replay.ferrari import FERRARI_GEOMETRY, curve_section_and_trace
from vehicle_client.pipeline import Summarised, summarise_passage

AT = 800  # five seconds into the section, in the bend


@pytest.mark.parametrize("fault", Fault, ids=lambda fault: fault.name.lower())
def test_every_fault_ends_as_it_should(fault):
    section, trace = curve_section_and_trace()
    match EXPECTED[fault]:
        case Unreadable(error):
            with pytest.raises(error):
                applied(fault, trace, at=AT)
        case Refusal(reason):
            outcome = summarise_passage(applied(fault, trace, at=AT), section, vehicle=FERRARI_GEOMETRY)
            assert isinstance(outcome, Rejected), outcome
            assert outcome.reason is reason
        case Summary(flags):
            whole = summarise_passage(trace, section, vehicle=FERRARI_GEOMETRY)
            broken = summarise_passage(applied(fault, trace, at=AT), section, vehicle=FERRARI_GEOMETRY)
            assert isinstance(whole, Summarised)
            assert isinstance(broken, Summarised), broken
            assert broken.summary.quality == whole.summary.quality | flags
            assert broken.match.exit_s == pytest.approx(whole.match.exit_s, abs=0.1)
            assert broken.summary.values[44] == pytest.approx(whole.summary.values[44], rel=0.01)


def test_every_fault_has_a_result():
    assert set(EXPECTED) == set(Fault)
