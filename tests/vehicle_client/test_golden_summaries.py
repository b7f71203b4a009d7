"""The onboard client answers fixed drives as it did.

What the answers must obey is tested by law: the paper's statistics in `test_pipeline`, grip in `estimation/grip`.
"""

import pytest

from roadgrip.features import NEWEST_TABLE, PAPER_TABLE
from tests.vehicle_client.golden_summaries import SIMULATED, SYNTHETIC, golden_values, summary_values

WRITTEN = 1e-5
"""Relative: the table holds six digits."""
SIMULATED_TOLERANCE = 2e-3
"""Relative to the largest of a signal's statistics: another processor may round a simulated drive otherwise."""
GRIP_TOLERANCE = 0.01
"""Relative: likelihoods are sums over a drive, and where they fall steeply a little of it moves them."""
GRIP_FLOOR = 2e-3


def names() -> list[str]:
    return [feature.name for feature in NEWEST_TABLE.kinematic]


def test_the_table_names_the_features_in_their_order():
    assert list(golden_values(SYNTHETIC)) == names()


def test_a_synthetic_drive_is_summarised_as_it_was():
    golden = golden_values(SYNTHETIC)
    for name, value in zip(names(), summary_values(SYNTHETIC), strict=True):
        assert value == pytest.approx(golden[name], rel=WRITTEN, abs=1e-9), name


@pytest.mark.sim
@pytest.mark.parametrize("drive", SIMULATED)
def test_a_simulated_drive_is_summarised_as_it_was(drive):
    golden = golden_values(drive)
    values = dict(zip(names(), summary_values(drive), strict=True))
    statistics = names()[: len(PAPER_TABLE.kinematic)]
    for name in set(values) - set(statistics):
        assert values[name] == pytest.approx(golden[name], rel=GRIP_TOLERANCE, abs=GRIP_FLOOR), name
    for name in statistics:
        # Eleven in a row belong to one signal; skewness and kurtosis are of the order of one by themselves.
        first = statistics.index(name) // 11 * 11
        dimensionless = name.endswith(("_skewness", "_kurtosis"))
        largest = 1.0 if dimensionless else max(abs(golden[other]) for other in statistics[first : first + 9])
        scale = max(largest, abs(golden[name]))
        assert values[name] == pytest.approx(golden[name], abs=SIMULATED_TOLERANCE * scale), name
