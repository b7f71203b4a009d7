"""A virtual bus: what comes from it, and what happens when nobody asks, or the bus breaks."""

import time
from collections.abc import Iterator
from itertools import count
from threading import Event

import can
import pytest

from roadgrip.errors import ConfigurationError
from tests.vehicle_client.shell.can.cars import drive, mapping
from vehicle_client.shell.can.buses import open_bus, send_frame
from vehicle_client.shell.can.description import path_of_signals, read_can_mapping
from vehicle_client.shell.can.live import CanSource
from vehicle_client.shell.can.player import play_log
from vehicle_client.shell.can.written import write_log

EXAMPLE = read_can_mapping(path_of_signals("example"))
STEERING = 0x102
HALF_TURN = (168.0 + 2048.0) / 0.0625
PATIENCE_S = 10.0


@pytest.fixture
def buses(request) -> Iterator[tuple[can.BusABC, can.BusABC]]:
    """Two ends of a wire that is this test's own."""
    name = request.node.name
    with open_bus("virtual", name) as car, open_bus("virtual", name, frame_ids=EXAMPLE.frame_ids) as ours:
        yield car, ours


def steering(angle=HALF_TURN):
    return int(angle).to_bytes(2, "big") + b"\x00\x00"


def wait_for(condition):
    give_up_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s, "nothing came"
        time.sleep(0.005)


def test_values_come_in_our_units_with_our_time(buses):
    car, ours = buses
    clock = count(100)
    with CanSource(ours, EXAMPLE, now_s=lambda: float(next(clock))) as source:
        assert send_frame(car, 0x7FF, b"\x00")
        assert send_frame(car, STEERING, steering())
        assert send_frame(car, STEERING, b"\xff\xff\x00\x00")
        wait_for(lambda: source.counts.frames_count == 2)
        first, second = source.poll()
    assert (first.channel, first.time_s, second.time_s) == ("steer_rad", 100.0, 101.0)
    assert first.value == pytest.approx(0.1745, abs=1e-3)
    assert second.value != second.value  # NaN: the car does not know
    assert source.poll() == []


def test_a_queue_that_nobody_empties_drops_the_oldest_and_counts_them(buses):
    car, ours = buses
    with CanSource(ours, EXAMPLE, queue_length=3) as source:
        for i in range(5):
            send_frame(car, STEERING, steering(HALF_TURN + 1000 * i))
        wait_for(lambda: source.counts.frames_count == 5)
        values = [value.value for value in source.poll()]
    assert source.counts.dropped_count == 2
    assert len(values) == 3
    assert values == sorted(values)


def test_a_known_delay_of_a_sensor_is_taken_back(buses, tmp_path):
    car, ours = buses
    slow = mapping(tmp_path, ('signal = "SteeringWheelAngle"', 'signal = "SteeringWheelAngle"\ndelay_s = 0.5'))
    with CanSource(ours, slow, now_s=lambda: 7.0) as source:
        send_frame(car, STEERING, steering())
        wait_for(lambda: source.counts.frames_count == 1)
        assert [value.time_s for value in source.poll()] == [6.5]


def test_a_bus_that_breaks_ends_the_source_and_says_why():
    class Broken:
        def recv(self, timeout=None):
            raise can.CanOperationError("the cable is out")

    with CanSource(Broken(), EXAMPLE) as source:  # type: ignore[arg-type]
        wait_for(lambda: not source.alive)
    assert source.counts.failure == "the cable is out"


def test_a_bus_that_breaks_is_opened_again_as_often_as_it_takes(buses):
    car, ours = buses
    opened: list[can.BusABC] = []

    class Broken:
        is_shut_down = False

        def recv(self, timeout=None):
            raise OSError("the cable is out")

        def shutdown(self):
            self.is_shut_down = True

    def reopen() -> can.BusABC:
        opened.append(ours)
        if len(opened) == 1:
            raise ConfigurationError("still out")
        return Broken() if len(opened) == 2 else ours  # type: ignore[return-value]

    first = Broken()
    with CanSource(first, EXAMPLE, reopen=reopen, reopen_s=0.01) as source:  # type: ignore[arg-type]
        wait_for(lambda: len(opened) == 3 and not source.broken)
        assert first.is_shut_down
        assert source.counts.reopened_count == 1
        assert source.counts.errors_count == 3
        send_frame(car, STEERING, steering())
        wait_for(lambda: source.counts.frames_count == 1)


def test_a_source_is_closed_at_once_while_its_bus_is_broken():
    class Broken:
        def recv(self, timeout=None):
            raise OSError("the cable is out")

    def reopen() -> can.BusABC:
        raise ConfigurationError("still out")

    source = CanSource(Broken(), EXAMPLE, reopen=reopen, reopen_s=60.0)  # type: ignore[arg-type]
    wait_for(lambda: source.broken)
    assert source.alive
    source.close()
    assert not source.alive


def test_an_adapter_that_does_not_exist_is_said():
    with pytest.raises(ConfigurationError, match="cannot open CAN no-such-adapter can0"):
        open_bus("no-such-adapter", "can0")


def test_a_log_is_played_onto_a_bus_in_its_order(buses, tmp_path):
    car, ours = buses
    write_log(tmp_path / "drive.blf", drive(), EXAMPLE)
    with CanSource(ours, EXAMPLE, queue_length=200_000) as source:
        sent_count = play_log(tmp_path / "drive.blf", car, speedup_ratio=1000.0)
        wait_for(lambda: source.counts.frames_count == sent_count)
        channels = {value.channel for value in source.poll()}
    assert {"accel_x_mps2", "steer_rad", "lat_deg", "stability_active"} <= channels
    assert source.counts.dropped_count == 0


def test_a_log_waits_between_its_frames_and_can_be_stopped(buses, tmp_path):
    car, _ = buses
    write_log(tmp_path / "drive.log", drive(), EXAMPLE)
    stopped = Event()
    stopped.set()
    assert play_log(tmp_path / "drive.log", car, stopped=stopped) == 0
