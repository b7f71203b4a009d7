import secrets
from dataclasses import replace
from importlib.resources import files
from typing import Any

import cantools
import pytest

from roadgrip.records import Confidence, FrictionInterval
from tests.vehicle_client.shell.air import ADVICE
from vehicle_client.shell.can.buses import open_bus
from vehicle_client.shell.live.advisory_frame import AdvisoryFrames, AdvisorySender, crc8_j1850
from vehicle_client.shell.live.dashboard import ShownAdvice

INTERVAL = FrictionInterval(
    mu_low=0.287,
    mu_new=0.36,
    median_mu=0.32,
    median_low_mu=0.31,
    median_high_mu=0.33,
    coverage_frac=0.95,
    passages_count=60,
    confidence=Confidence.RECOMMENDED,
    newest_age_s=20.0,
    valid_for_s=300.0,
)


def database() -> Any:
    text = files("vehicle_client.shell.live").joinpath("advisory.dbc").read_text(encoding="utf-8")
    return cantools.database.load_string(text, database_format="dbc")


def shown(**changes: Any) -> ShownAdvice:
    return ShownAdvice("bend", replace(ADVICE, **changes), expires_s=150.0)


def decoded(data: bytes) -> dict[str, Any]:
    values: dict[str, Any] = database().decode_message("RoadgripAdvisory", data, decode_choices=False)
    return values


def test_the_checksum_is_the_published_one():
    assert crc8_j1850(b"123456789") == 0x4B


def test_advice_comes_through_the_bus_as_it_was():
    name = f"advisory-{secrets.token_hex(4)}"
    with open_bus("virtual", name) as car, open_bus("virtual", name) as cluster:
        send = AdvisorySender(car, AdvisoryFrames())
        assert send(shown(confidence=Confidence.RECOMMENDED, interval=INTERVAL), True, 100.0)
        frame = cluster.recv(timeout=5.0)
    assert frame is not None
    assert frame.arbitration_id == 1824
    values = decoded(bytes(frame.data))
    assert values["SpeedKmh"] == 50
    assert values["FrictionLowPercent"] == 28
    assert values["ValidForS"] == 50
    assert values["Confidence"] == 3
    assert values["Shown"] == 1
    assert values["Inside"] == 1
    assert values["Checksum"] == crc8_j1850(bytes(frame.data)[:7])


def test_taking_advice_away_says_none_everywhere():
    values = decoded(AdvisoryFrames().frame_of(None, inside=False, now_s=0.0))
    assert values["Shown"] == 0
    assert values["SpeedKmh"] == 255
    assert values["FrictionLowPercent"] == 255
    assert values["ValidForS"] == 0


def test_the_counter_runs_through_sixteen_values():
    frames = AdvisoryFrames()
    counters = [decoded(frames.frame_of(shown(), inside=False, now_s=0.0))["Counter"] for _ in range(18)]
    assert counters == [*range(16), 0, 1]


def test_a_changed_byte_does_not_fit_the_checksum():
    data = bytearray(AdvisoryFrames().frame_of(shown(), inside=False, now_s=0.0))
    for at in range(7):
        spoiled = data.copy()
        spoiled[at] ^= 0x10
        assert crc8_j1850(bytes(spoiled[:7])) != spoiled[7]


@pytest.mark.parametrize(("speed_mps", "speed_kmh"), [(60.0 / 3.6, 60), (0.0, 0), (200.0, 254), (16.6, 59)])
def test_the_speed_is_never_above_the_advice(speed_mps: float, speed_kmh: int):
    frame = AdvisoryFrames().frame_of(shown(speed_mps=speed_mps), inside=False, now_s=0.0)
    assert decoded(frame)["SpeedKmh"] == speed_kmh


def test_a_car_whose_network_needs_another_identifier_gets_it():
    assert AdvisoryFrames(frame_id=0x123).frame_id == 0x123
