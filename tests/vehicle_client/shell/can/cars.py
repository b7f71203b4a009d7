"""A small car for tests: its DBC, its mapping, and a drive it could have made."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.vehicle_client.synthetic import drive_over, fixes_of, road, s_turn, surveyed, with_noise
from vehicle_client.estimation.trace import Trace
from vehicle_client.shell.can.description import CanMapping, path_of_signals, read_can_mapping

EXAMPLE = path_of_signals("example")
SECTION = surveyed(road(s_turn))


def drive() -> Trace:
    """A drive with ordinary sensors, positions, a flag that is set for a while, and a fifth of a second missing."""
    trace, station = drive_over(s_turn, swing_mps=2.0)
    valid = np.ones(trace.samples_count, dtype=bool)
    valid[100:120] = False
    fixes = fixes_of(SECTION, trace.time_s, station, rng=np.random.default_rng(1), noise_m=0.3)
    return replace(
        with_noise(trace, np.random.default_rng(2)),
        valid=valid,
        stability_active=(station > 300.0) & (station < 320.0),
        gnss=replace(fixes, speed_mps=15.0 + 0.1 * np.sin(fixes.time_s)),
    )


def mapping(folder: Path, *changes: tuple[str, str], dbc_changes: tuple[tuple[str, str], ...] = ()) -> CanMapping:
    """Return the packaged example with words of its mapping and of its DBC changed."""
    signals = EXAMPLE.read_text(encoding="utf-8")
    dbc = (EXAMPLE.parent / "roadgrip-example.dbc").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in signals
        signals = signals.replace(old, new)
    for old, new in dbc_changes:
        assert old in dbc
        dbc = dbc.replace(old, new)
    (folder / "signals.toml").write_text(signals, encoding="utf-8")
    (folder / "roadgrip-example.dbc").write_text(dbc, encoding="utf-8")
    return read_can_mapping(folder / "signals.toml")
