"""Messages to try the air with: one of each kind, and strategies for all there can be."""

from functools import cache
from typing import Any

import cbor2
import numpy as np
import pytest
from hypothesis import strategies as st

from roadgrip.errors import WireError
from roadgrip.features import PAPER_TABLE
from roadgrip.reasons import Reason
from roadgrip.records import (
    Accepted,
    Advisory,
    AdvisoryNotice,
    AdvisoryReason,
    Arrival,
    Beacon,
    Confidence,
    Cookie,
    FrictionInterval,
    KinematicSummary,
    MapOffer,
    Message,
    NotCounted,
    Passage,
    QualityFlag,
    Receipt,
    Rejected,
)
from roadgrip.section import BankOrigin, Direction, GnssAnchor, RoadSection, build_section
from roadgrip.units import kph_to_mps
from roadgrip.wire import Kind, decode_message, encode_message

PASSAGE_ID = bytes(range(16))


@cache
def winding_road(nodes_count: int = 61, *, section_id: str = "winding-road", step_m: float = 9.9) -> RoadSection:
    """Return a road of alternating bends, climbing and banked, with anchors."""
    way_m = np.arange(nodes_count) * step_m
    heading_rad = 0.9 * np.sin(way_m / 95.0)
    nodes_m = np.column_stack(
        [
            np.cumsum(step_m * np.cos(heading_rad)),
            np.cumsum(step_m * np.sin(heading_rad)),
            8.0 * np.sin(way_m / 400.0),
        ]
    )
    return build_section(
        section_id=section_id,
        name="Winding road, Ringebu",
        nodes_m=nodes_m - nodes_m[0],
        speed_limit_mps=kph_to_mps(80.0),
        cross_slope_ratio=-0.06 * np.sign(np.cos(way_m / 95.0)),
        bank_origin=BankOrigin.MEASURED,
        direction=Direction.AGAINST,
        crs="EPSG:25833",
        origin_m=(251_200.125, 6_834_600.5, 905.25),
        anchors=[GnssAnchor(station_m, 61.56 + station_m * 1e-5, 10.31) for station_m in (0.0, 250.0, 500.0)],
    )


SECTION = winding_road()
INTERVAL = FrictionInterval(
    mu_low=0.3912,
    mu_new=0.489,
    median_mu=0.4401,
    median_low_mu=0.4312,
    median_high_mu=0.4498,
    coverage_frac=0.9569,
    passages_count=57,
    confidence=Confidence.RECOMMENDED,
    newest_age_s=41.5,
    valid_for_s=900.0,
)
VALUES = tuple(float(v) for v in np.random.default_rng(7).normal(size=len(PAPER_TABLE.kinematic)).astype(np.float32))

ARRIVAL = Arrival(PASSAGE_ID, SECTION.section_id)
MAP_OFFER = MapOffer(SECTION, (PAPER_TABLE.digest,))
ADVISORY = AdvisoryNotice(
    SECTION.section_id,
    SECTION.version,
    Advisory(kph_to_mps(60.0), AdvisoryReason.FRICTION_INTERVAL, Confidence.RECOMMENDED, INTERVAL, 600.0),
    1_770_000_000,
)
PASSAGE = Passage(
    PASSAGE_ID,
    SECTION.section_id,
    SECTION.version,
    KinematicSummary(VALUES, PAPER_TABLE.digest, 31.27, QualityFlag.STABILITY_ACTIVE | QualityFlag.NO_GNSS),
    2.35,
)
RECEIPT = Receipt(PASSAGE_ID, Accepted(NotCounted.OUT_OF_ENVELOPE))
REFUSAL = Receipt(PASSAGE_ID, Rejected(Reason.STALE_MAP, "the map is now 0123456789abcdef"))
BEACON = Beacon(
    SECTION.section_id,
    SECTION.version,
    kph_to_mps(45.0),
    AdvisoryReason.WINTER_SPEED_FEW_VEHICLES,
    Confidence.INSUFFICIENT,
    120.0,
    1_770_000_000,
)

SAMPLES: dict[str, Message] = {
    "arrival": ARRIVAL,
    "arrival-knows-map": Arrival(PASSAGE_ID, SECTION.section_id, SECTION.version),
    "arrival-with-cookie": Arrival(PASSAGE_ID, SECTION.section_id, SECTION.version, b"biscuit!"),
    "cookie": Cookie(b"biscuit!"),
    "map": MAP_OFFER,
    "map-in-pieces": MapOffer(
        winding_road(400, section_id="winding-road-long"), (PAPER_TABLE.digest, "0123456789abcdef")
    ),
    "advisory": ADVISORY,
    "advisory-winter-speed": AdvisoryNotice(
        SECTION.section_id,
        SECTION.version,
        Advisory(kph_to_mps(55.0), AdvisoryReason.WINTER_SPEED_NO_MODEL, Confidence.INSUFFICIENT, None, 60.0),
        0,
    ),
    "summary": PASSAGE,
    "receipt-accepted": RECEIPT,
    "receipt-rejected": REFUSAL,
    "beacon": BEACON,
}


def fields_of(message: Message) -> dict[int, Any]:
    fields: dict[int, Any] = cbor2.loads(encode_message(message))
    return fields


def reason_for(kind: Kind, payload: bytes) -> Reason:
    with pytest.raises(WireError) as caught:
        decode_message(kind, payload)
    return caught.value.reason


section_ids = st.text("abcdefghijklmnopqrstuvwxyz0123456789-", min_size=1, max_size=48)
passage_ids = st.binary(min_size=16, max_size=16)
digests = st.binary(min_size=8, max_size=8).map(bytes.hex)
float32s = st.floats(width=32, allow_nan=False, allow_infinity=False)
seconds = st.floats(0.0, 4.0e7)
mus = st.floats(0.0, 6.0)
speeds_mps = st.floats(0.0, 180.0)
confidences = st.sampled_from(Confidence)
advisory_reasons = st.sampled_from(AdvisoryReason)

eight_bytes = st.binary(min_size=8, max_size=8)
arrivals = st.builds(
    Arrival, passage_ids, section_ids, st.one_of(st.just(""), digests), st.one_of(st.just(b""), eight_bytes)
)
cookies = st.builds(Cookie, eight_bytes)
summaries = st.builds(
    KinematicSummary,
    values=st.lists(float32s, min_size=55, max_size=55).map(tuple),
    table_digest=st.just(PAPER_TABLE.digest),
    duration_s=seconds,
    quality=st.integers(0, int(sum(QualityFlag))).map(QualityFlag),
)
passages = st.builds(Passage, passage_ids, section_ids, digests, summaries, seconds)
receipts = st.builds(
    Receipt,
    passage_ids,
    st.one_of(
        st.builds(Accepted, st.integers(0, 7).map(NotCounted)),
        st.builds(Rejected, st.sampled_from(Reason), st.text(max_size=120)),
    ),
)
intervals = st.builds(
    FrictionInterval,
    mu_low=mus,
    mu_new=mus,
    median_mu=mus,
    median_low_mu=mus,
    median_high_mu=mus,
    coverage_frac=st.floats(0.0, 1.0),
    passages_count=st.integers(0, 2**32 - 1),
    confidence=confidences,
    newest_age_s=seconds,
    valid_for_s=seconds,
)
advisories = st.builds(Advisory, speeds_mps, advisory_reasons, confidences, st.none() | intervals, seconds)
notices = st.builds(AdvisoryNotice, section_ids, digests, advisories, st.integers(0, 2**40))
beacons = st.builds(
    Beacon, section_ids, digests, speeds_mps, advisory_reasons, confidences, seconds, st.integers(0, 2**40)
)


@st.composite
def map_offers(draw: st.DrawFn) -> MapOffer:
    """Draw a smooth road of some length with some of everything."""
    nodes_count = draw(st.integers(4, 200))
    step_m = draw(st.floats(7.0, 25.0))
    turn_rad = draw(st.floats(-1.2, 1.2))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    heading_rad = draw(st.floats(-3.0, 3.0)) + turn_rad * np.sin(np.arange(nodes_count) * step_m / 150.0)
    nodes_m = np.column_stack(
        [
            np.cumsum(step_m * np.cos(heading_rad)),
            np.cumsum(step_m * np.sin(heading_rad)),
            np.cumsum(rng.uniform(-0.1, 0.1, nodes_count) * step_m),
        ]
    )
    section = build_section(
        section_id=draw(section_ids),
        name=draw(st.text(st.characters(codec="utf-8").filter(str.isprintable), max_size=80)),
        nodes_m=nodes_m + rng.uniform(-1e4, 1e4, 3),
        speed_limit_mps=draw(st.floats(1.0, 60.0)),
        cross_slope_ratio=None if draw(st.booleans()) else rng.uniform(-0.2, 0.2, nodes_count),
        bank_origin=draw(st.sampled_from(BankOrigin)),
        direction=draw(st.sampled_from(Direction)),
        crs=draw(st.sampled_from(["local", "EPSG:25833"])),
        origin_m=(draw(st.floats(-1e7, 1e7)), draw(st.floats(-1e7, 1e7)), draw(st.floats(-500.0, 9000.0))),
        bank_cap_ratio=draw(st.floats(0.0, 0.25)),
        anchors=[
            GnssAnchor(float(s), float(lat), float(lon))
            for s, lat, lon in rng.uniform([0, -90, -180], [5000, 90, 180], (draw(st.integers(0, 5)), 3))
        ],
    )
    return MapOffer(section, tuple(draw(st.lists(digests, min_size=1, max_size=3))))


messages: st.SearchStrategy[Message] = st.one_of(arrivals, cookies, map_offers(), notices, passages, receipts, beacons)
