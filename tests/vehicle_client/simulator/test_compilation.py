import subprocess
import sys
from typing import NamedTuple

from vehicle_client.simulator.compilation import code_digest
from vehicle_client.simulator.journey import DIGEST

SCALE = 2.0


class Record(NamedTuple):
    first: float
    second: float


def inner(x):
    return SCALE * x


def outer(x):
    return inner(x) + Record(1.0, 2.0).first


def digest_with(monkeypatch, name, value):
    monkeypatch.setitem(outer.__globals__, name, value)
    return code_digest(outer)


def test_the_digest_sees_an_edit_in_a_called_function(monkeypatch):
    before = code_digest(outer)

    def edited(x):
        return SCALE * x * x

    assert digest_with(monkeypatch, "inner", edited) != before


def test_the_digest_sees_another_number(monkeypatch):
    before = code_digest(outer)
    assert digest_with(monkeypatch, "SCALE", 3.0) != before


def test_the_digest_sees_another_order_of_a_record(monkeypatch):
    class Turned(NamedTuple):
        second: float
        first: float

    before = code_digest(outer)
    assert digest_with(monkeypatch, "Record", Turned) != before


def test_the_digest_is_the_same_in_another_process():
    script = "from vehicle_client.simulator.journey import DIGEST; print(DIGEST)"
    printed = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert int(printed) == DIGEST
