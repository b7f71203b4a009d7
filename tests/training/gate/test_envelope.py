"""What is called strange, and what should be."""

import pytest

from tests.training.gate.bouts import case, contender, drives, thresholds
from training.gate.envelope import envelope

LIMITS = thresholds().envelope


@pytest.mark.parametrize(
    ("role", "driven_as", "passed"),
    [
        ("known_roads", "known_roads", True),
        ("unseen_roads", "manoeuvres", False),
        ("manoeuvres", "manoeuvres", True),
        ("manoeuvres", "unseen_roads", False),
    ],
)
def test_ordinary_drives_are_seldom_strange_and_manoeuvres_nearly_always(tmp_path, role, driven_as, passed):
    runs = drives(driven_as, roads_count=1)
    check = envelope(case(role, runs, contender(tmp_path / "a")), LIMITS)
    assert check is not None
    assert check.passed is passed


def test_measured_drives_are_not_asked(tmp_path):
    assert envelope(case("measured", drives("measured", roads_count=1), contender(tmp_path / "a")), LIMITS) is None
