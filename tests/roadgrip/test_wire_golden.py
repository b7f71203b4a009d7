"""Version 1 of the wire format means these bytes, for ever."""

import pytest

from roadgrip.wire import Kind, kind_of
from tests.roadgrip.wire_golden import FOLDER, cases, diagnosis, frames_in, frames_of, hex_dump, received_in

NAMES = sorted(path.stem for path in FOLDER.glob("*.hex"))


def test_there_is_a_golden_file_for_every_kind_signed_and_unsigned():
    assert set(NAMES) == set(cases())
    for signed in (False, True):
        kinds = {kind_of(message) for message, is_signed in cases().values() if is_signed == signed}
        assert kinds == set(Kind) - ({Kind.COOKIE} if signed else set())


def test_one_of_them_is_in_pieces():
    assert len(frames_in((FOLDER / "map-in-pieces.hex").read_text(encoding="utf-8"))) > 1


@pytest.mark.parametrize("name", NAMES)
def test_golden_bytes_say_what_stands_beside_them(name):
    signed = name.endswith("-signed")
    received = received_in(frames_in((FOLDER / f"{name}.hex").read_text(encoding="utf-8")), signed=signed)
    assert diagnosis(received) == (FOLDER / f"{name}.json").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", NAMES)
def test_what_golden_bytes_say_encodes_to_them_again(name):
    signed = name.endswith("-signed")
    dump = (FOLDER / f"{name}.hex").read_text(encoding="utf-8")
    message = received_in(frames_in(dump), signed=signed).message
    assert hex_dump(frames_of(message, signed=signed)) == dump
