"""The bench of the appliance: what it sends, what it counts, and what it makes of the figures."""

import socket
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from bench.appliance.beside_peers import times_of
from bench.appliance.http_load import ask, get, is_whole, post
from bench.appliance.load import BIN_S, recovered_after_s, usual_s
from bench.appliance.page import filled, targets_table
from bench.appliance.passages import draw_batch
from bench.appliance.sections import served_sections
from bench.appliance.targets import TARGETS, headline
from bench.appliance.udp_load import ACCEPTED, REJECTED, UNANSWERED, Exchange, exchange, line_to
from roadgrip.frames import exchange_id_of, parse_frame, section_key_of, split_into_frames
from roadgrip.protocol import Kind
from roadgrip.reasons import Reason
from roadgrip.records import Accepted, Passage, Receipt, Rejected
from roadgrip.wire import decode_message, encode_message
from rsu_app.adapters.http.models import PassageModel
from rsu_app.domain.plausibility import implausibility, summary_values

SECTIONS = {section.section_id: section for section in served_sections()}


def drawn(count: int, seed: int = 1):
    return draw_batch(count, rng=np.random.default_rng(seed))


def passage_in(frame) -> Passage:
    message = decode_message(frame.kind, frame.fragment)
    assert isinstance(message, Passage)
    return message


def passages_of(batch):
    for frame in map(parse_frame, batch.frames()):
        yield frame, passage_in(frame)


def test_every_passage_of_a_batch_is_plausible_and_new():
    seen = set()
    for frame, passage in passages_of(drawn(200)):
        assert implausibility(passage, SECTIONS[passage.section_id]) is None
        assert frame.exchange_id == exchange_id_of(passage.passage_id)
        seen |= {passage.passage_id, passage.summary.values}
    assert len(seen) == 400


def test_the_place_in_the_batch_stands_in_the_id_behind_the_batch_s_tag():
    batch = drawn(300)
    for number, (frame, _) in enumerate(passages_of(batch)):
        assert frame.exchange_id == batch.tag + number.to_bytes(4, "big")


def test_json_says_what_the_frames_say():
    batch = drawn(20)
    for (section_id, body), (_, passage) in zip(batch.json_bodies(), passages_of(batch), strict=True):
        record = PassageModel.model_validate_json(body).to_record(section_id)
        assert np.array_equal(summary_values(record.summary), summary_values(passage.summary))
        assert (record.passage_id, record.section_id, record.map_version, record.age_s) == (
            (passage.passage_id, passage.section_id, passage.map_version, passage.age_s)
        )


@contextmanager
def unit_that(answers):
    """A server that answers the datagram of each place in the batch with an outcome, or not at all."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(("127.0.0.1", 0))

    def serve() -> None:
        while True:
            data, address = link.recvfrom(2048)
            if not data:
                return
            frame = parse_frame(data)
            outcome = answers(int.from_bytes(frame.exchange_id[4:], "big"))
            if outcome is None:
                continue
            passage = passage_in(frame)
            receipt = encode_message(Receipt(passage.passage_id, outcome))
            (answer,) = split_into_frames(
                Kind.RECEIPT,
                receipt,
                exchange_id=frame.exchange_id,
                section_key=section_key_of(passage.section_id),
            )
            link.sendto(answer, address)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield link.getsockname()[1]
    finally:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as last:
            last.sendto(b"", link.getsockname())
        thread.join()
        link.close()


def test_receipts_are_told_apart_and_what_has_none_is_counted_as_unanswered():
    ends = {0: None, 1: Rejected(Reason.BUSY, "256 passages are in work")}
    batch = drawn(60)
    with unit_that(lambda number: ends.get(number, Accepted())) as port, line_to("127.0.0.1", port) as line:
        done = exchange(line, batch.frames(), batch.tag, outstanding_count=8, silence_s=0.2)
    assert done.verdicts.tolist() == [UNANSWERED, REJECTED] + [ACCEPTED] * 58
    assert len(done.latency_s) == 58
    assert (done.latency_s > 0.0).all()


def test_passages_at_a_pace_are_sent_no_sooner_than_they_are_due():
    batch = drawn(50)
    with unit_that(lambda _: Accepted()) as port, line_to("127.0.0.1", port) as line:
        done = exchange(line, batch.frames(), batch.tag, rate_per_s=500.0)
    assert done.count(ACCEPTED) == 50
    assert (done.sent_s >= done.due_s).all()
    assert np.ptp(done.due_s) == pytest.approx(49 / 500.0)


def exchange_at_1000(answered_after_s):
    due_s = np.arange(len(answered_after_s)) / 1000.0
    verdicts = np.where(np.isnan(answered_after_s), UNANSWERED, ACCEPTED).astype(np.uint8)
    return Exchange(due_s, due_s, due_s + answered_after_s, verdicts, float(due_s[-1]))


def test_recovery_lasts_until_the_last_moment_that_was_not_in_order():
    took_s = np.full(2000, 0.004)
    assert recovered_after_s(exchange_at_1000(took_s), limit_s=0.025) == 0.0
    took_s[300] = np.nan  # one without a receipt in the second quarter of a second
    assert recovered_after_s(exchange_at_1000(took_s), limit_s=0.025) == 2 * BIN_S
    took_s[600:700] = 0.2  # and late ones in the third
    assert recovered_after_s(exchange_at_1000(took_s), limit_s=0.025) == 3 * BIN_S
    # A unit that is as slow at all times has not been held up.
    assert recovered_after_s(exchange_at_1000(took_s), limit_s=usual_s(exchange_at_1000(took_s))) == 2 * BIN_S
    took_s[-50:] = 0.2
    assert recovered_after_s(exchange_at_1000(took_s), limit_s=0.025) is None


@pytest.mark.parametrize(
    ("heard", "whole"),
    [
        (b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n", False),
        (b"HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\nh", False),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nhi", True),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n2\r\nhi\r\n", False),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n2\r\nhi\r\n0\r\n\r\n", True),
        (b"HTTP/1.1 204 No Content\r\n\r\n", True),
    ],
)
def test_an_answer_ends_where_its_head_says(heard, whole):
    assert is_whole(heard) is whole


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_POST(self):
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.send_response(200 if body == b"right" else 422)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_):
        pass


def test_requests_that_are_refused_are_counted_and_the_first_is_shown():
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        requests = [post("/", body, media_type="text/plain") for body in (b"right", b"wrong", b"right")]
        done = ask("127.0.0.1", server.server_port, requests, requests_count=30, connections_count=3)
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
    assert done.good.tolist() == [True, False, True] * 10
    assert done.first_bad.startswith(b"HTTP/1.1 422")
    assert get("/map").startswith(b"GET /map HTTP/1.1\r\n")


def test_peers_are_held_against_what_was_measured_in_the_same_turn():
    # The same servers, while the machine was fast, slow and very slow.
    costs = {"udp": 200.0, "http": 500.0, "http_json": 400.0, "mlserver": 2_000.0}
    turns = [{name: cost * slow for name, cost in costs.items()} for slow in (1.0, 2.5, 4.0)]
    figures = headline({"peers": {"times": times_of(turns, ["mlserver"])}})
    assert figures == {"http_times_mlserver": 4.0, "http_json_times_mlserver": 5.0, "udp_times_mlserver": 10.0}


def test_the_table_says_what_was_met_missed_and_not_measured():
    table = targets_table({"rss_mb": 120.0, "install_mb": 300.0, "parts": {}})
    rows = {line.split("|")[1].strip(): line for line in table.splitlines()}
    assert rows["memory with 100,000 passages in the window"].endswith("| met |")
    assert "**missed**" in rows["installed size"]
    assert rows["passages over UDP"].endswith("| not measured |")
    assert len(rows) == len(TARGETS) + 2  # head and rule


def test_paragraphs_are_filled_and_tables_are_left_alone():
    page = filled("one\ntwo\n\n| a | b |\n|---|---|\n| 1 | 2 |\n")
    assert page == "one two\n\n| a | b |\n|---|---|\n| 1 | 2 |\n"
