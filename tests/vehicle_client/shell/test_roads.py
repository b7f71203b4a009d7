from __future__ import annotations

import asyncio

import pytest

from roadgrip.errors import ConfigurationError
from tests.vehicle_client.shell.air import BEND, Ether, TokenCodec, Unit
from tests.vehicle_client.shell.cars import WireToUnit
from vehicle_client.shell.patience import Patience
from vehicle_client.shell.roads import ask_for_section


def test_a_vehicle_without_a_map_asks_the_unit():
    ether = Ether()
    link = WireToUnit(Unit(TokenCodec(ether)))
    section = asyncio.run(ask_for_section("bend", uplink=link, open_codec=lambda _: TokenCodec(ether)))
    assert section == BEND


def test_a_unit_that_does_not_serve_the_section_is_said():
    ether = Ether()
    link = WireToUnit(Unit(TokenCodec(ether), frames_left_count=0))
    asking = ask_for_section(
        "bend", uplink=link, open_codec=lambda _: TokenCodec(ether), patience=Patience(reply_s=0.01, longest_s=0.02)
    )
    with pytest.raises(ConfigurationError, match="did not answer"):
        asyncio.run(asking)
