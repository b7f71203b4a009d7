import asyncio
import time
from collections import Counter
from collections.abc import Callable
from math import inf

import pytest

from bench.certified import NOW_UNIX_S, VERIFIER, claims_for
from bench.certified import UNIT as UNIT_SIGNER
from roadgrip.errors import ConfigurationError, WireError
from roadgrip.features import NEWEST_TABLE
from roadgrip.frames import section_key_of, split_into_frames
from roadgrip.reasons import Reason
from roadgrip.records import AdvisoryNotice, AdvisoryReason, Beacon, Confidence, MapOffer, Message
from roadgrip.signing import NO_CLAIMS, Claims, Signer
from roadgrip.wire import encode_message, kind_of
from tests.vehicle_client.shell.air import ADVICE, BEND
from vehicle_client.shell.keys import Keys
from vehicle_client.shell.live.units import (
    BROADCASTS_PER_S,
    IN_REACH_S,
    SECTIONS_LIMIT_COUNT,
    BroadcastListener,
    Heard,
    OldBroadcastError,
    UnitsInReach,
    heard_in,
    listen_for_broadcasts,
)
from vehicle_client.shell.uplink import UnitAddress

UNIT = ("192.0.2.7", 4740)


def beacon(*, issued_unix_s: int = NOW_UNIX_S, section_id: str = "bend") -> Beacon:
    return Beacon(
        section_id=section_id,
        map_version="0123456789abcdef",
        speed_mps=13.89,
        reason=AdvisoryReason.WINTER_SPEED_FEW_VEHICLES,
        confidence=Confidence.INSUFFICIENT,
        valid_for_s=300.0,
        issued_unix_s=issued_unix_s,
    )


def datagram(
    message: Message, *, signer: Signer | None = None, section_id: str = "bend", claims: Claims = NO_CLAIMS
) -> bytes:
    exchange_id = bytes(8)
    payload = encode_message(message, signer=signer, exchange_id=exchange_id, claims=claims)
    return split_into_frames(
        kind_of(message), payload, exchange_id=exchange_id, section_key=section_key_of(section_id)
    )[0]


def test_a_beacon_tells_section_map_and_the_units_own_address():
    heard = heard_in(datagram(beacon()), UNIT, verifier=None, wall_clock_s=NOW_UNIX_S + 3.0)
    assert heard == Heard("bend", "0123456789abcdef", UnitAddress("udp", "192.0.2.7", 4740))


def test_advice_that_a_detector_asked_for_tells_as_much():
    notice = AdvisoryNotice("bend", BEND.version, ADVICE, issued_unix_s=0)
    heard = heard_in(datagram(notice), UNIT, verifier=None, wall_clock_s=NOW_UNIX_S)
    assert heard is not None
    assert heard.section_id == "bend"


def test_a_map_that_a_detector_asked_for_is_passed_over():
    assert (
        heard_in(datagram(MapOffer(BEND, (NEWEST_TABLE.digest,))), UNIT, verifier=None, wall_clock_s=NOW_UNIX_S) is None
    )


@pytest.mark.parametrize("later_s", [61.0, -61.0, 86_400.0])
def test_a_beacon_played_again_is_refused(later_s: float):
    with pytest.raises(OldBroadcastError):
        heard_in(datagram(beacon()), UNIT, verifier=None, wall_clock_s=NOW_UNIX_S + later_s)


@pytest.mark.parametrize(
    ("issued_unix_s", "wall_clock_s", "age_limit_s"),
    [(0, NOW_UNIX_S, 60.0), (NOW_UNIX_S, 1_000.0, 60.0), (NOW_UNIX_S, NOW_UNIX_S + 1e6, inf)],
    ids=["the unit knows no time", "the car knows no time", "the car was told not to look"],
)
def test_where_one_of_both_knows_no_time_no_beacon_is_old(issued_unix_s: int, wall_clock_s: float, age_limit_s: float):
    data = datagram(beacon(issued_unix_s=issued_unix_s))
    assert heard_in(data, UNIT, verifier=None, wall_clock_s=wall_clock_s, age_limit_s=age_limit_s) is not None


def test_where_an_authority_is_trusted_an_unsigned_beacon_is_refused_and_a_signed_one_believed():
    with pytest.raises(WireError) as refused:
        heard_in(datagram(beacon()), UNIT, verifier=VERIFIER, wall_clock_s=NOW_UNIX_S)
    assert refused.value.reason is Reason.UNSIGNED
    data = datagram(beacon(), signer=UNIT_SIGNER, claims=claims_for(beacon(), section_id="bend"))
    assert heard_in(data, UNIT, verifier=VERIFIER, wall_clock_s=NOW_UNIX_S) is not None


NOTICE = AdvisoryNotice("bend", "0123456789abcdef", ADVICE, issued_unix_s=0)


@pytest.mark.parametrize("message", [beacon(issued_unix_s=0), NOTICE], ids=["beacon", "advice to all"])
@pytest.mark.parametrize("wall_clock_s", [NOW_UNIX_S, 1_000.0])
def test_what_is_sent_to_all_without_an_end_is_never_believed(message: Message, wall_clock_s: float):
    data = datagram(message, signer=UNIT_SIGNER, claims=Claims(None, None, "bend", "0123456789abcdef"))
    with pytest.raises(WireError) as refused:
        heard_in(data, UNIT, verifier=VERIFIER, wall_clock_s=wall_clock_s)
    assert refused.value.reason is Reason.OUTSIDE_REPLAY_WINDOW


def test_a_signed_beacon_ends_when_it_says():
    data = datagram(beacon(issued_unix_s=0), signer=UNIT_SIGNER, claims=claims_for(beacon(), section_id="bend"))
    assert heard_in(data, UNIT, verifier=VERIFIER, wall_clock_s=NOW_UNIX_S + 300) is not None
    with pytest.raises(WireError) as refused:
        heard_in(data, UNIT, verifier=VERIFIER, wall_clock_s=NOW_UNIX_S + 301)
    assert refused.value.reason is Reason.OUTSIDE_REPLAY_WINDOW


def test_a_unit_that_was_not_heard_lately_is_out_of_reach():
    units = UnitsInReach()
    heard = heard_in(datagram(beacon()), UNIT, verifier=None, wall_clock_s=NOW_UNIX_S)
    assert heard is not None
    units.note(heard, now_s=100.0)
    assert units.address_of("bend", now_s=100.0 + IN_REACH_S) == heard.address
    assert units.address_of("bend", now_s=100.0 + IN_REACH_S + 1.0) is None
    assert units.address_of("elsewhere", now_s=100.0) is None


def test_units_that_are_remembered_are_bounded():
    units = UnitsInReach()
    for number in range(1_000):
        units.note(Heard(f"s-{number}", "", UnitAddress("udp", "h", 1)), now_s=float(number))
    assert len(units) == SECTIONS_LIMIT_COUNT


def listening(on_heard: Callable[[Heard], None], counts: Counter[str], **more: object) -> BroadcastListener:
    return BroadcastListener(on_heard, keys=Keys(), age_limit_s=inf, counts=counts)


def test_rubbish_is_counted_by_what_is_wrong_with_it():
    counts: Counter[str] = Counter()
    listener = listening(lambda _: None, counts)
    listener.datagram_received(b"hello", UNIT)
    spoiled = bytearray(datagram(beacon()))
    spoiled[-1] ^= 1
    listener.datagram_received(bytes(spoiled), UNIT)
    listener.datagram_received(datagram(beacon()), UNIT)
    assert counts == {"beacons_refused_malformed": 1, "beacons_refused_bad_checksum": 1, "beacons_heard": 1}


def test_a_flood_is_dropped_unread():
    counts: Counter[str] = Counter()
    listener = listening(lambda _: None, counts)
    for _ in range(int(20 * BROADCASTS_PER_S)):
        listener.datagram_received(b"x", UNIT)
    assert counts["beacons_dropped_flood"] > 10 * BROADCASTS_PER_S


@pytest.mark.system
def test_beacons_arrive_on_a_socket_from_the_units_own():
    async def story() -> None:
        loop = asyncio.get_running_loop()
        came: asyncio.Queue[Heard] = asyncio.Queue()
        transport = await listen_for_broadcasts(listening(came.put_nowait, Counter()), host="127.0.0.1", port=0)
        place = transport.get_extra_info("sockname")
        unit, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, local_addr=("127.0.0.1", 0))
        unit.sendto(datagram(beacon(issued_unix_s=int(time.time()))), place)
        heard = await asyncio.wait_for(came.get(), 10.0)
        assert heard.address.port == unit.get_extra_info("sockname")[1]
        with pytest.raises(ConfigurationError, match="cannot listen"):
            await listen_for_broadcasts(listening(came.put_nowait, Counter()), host="127.0.0.1", port=place[1])
        unit.close()
        transport.close()
        await asyncio.sleep(0.0)

    asyncio.run(story())
