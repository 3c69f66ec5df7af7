import math

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.tactile import ElasticLayer
from protocol.wire.messages import (
    Bye,
    ClockReply,
    ClockRequest,
    Frame,
    Welcome,
    encode_control,
    encode_frame,
)
from protocol.wire.telemetry import TraceWriter, read_status, read_trace
from tests.support.sender import MS, Sender, display, run
from tests.support.streams import description

LIMIT_N = 2.5


def test_a_steady_force_is_reached_by_a_ramp_and_felt_to_half_a_microstep() -> None:
    felt = np.array(run(display(), Sender(), 0, 2000, force_n=0.5))
    assert felt[0] == 0.0
    assert felt[-1] == pytest.approx(0.5, abs=0.35e-3)
    start = int(np.flatnonzero(felt > 0.01)[0])
    full = int(np.flatnonzero(felt > 0.49)[0])
    assert 250 <= full - start <= 350
    assert np.abs(np.diff(felt)).max() < 3e-3


def test_strains_are_equal_although_the_layers_differ() -> None:
    thick = ElasticLayer(thickness_m=3e-3, young_modulus_pa=0.02e9)
    under_test = display()
    felt = run(under_test, Sender(stream=description(layer=thick)), 0, 2000, force_n=0.2)
    local = ElasticLayer()
    assert local.strain(felt[-1]) == pytest.approx(thick.strain(0.2), rel=2e-3)
    assert under_test.contactors[0].force_ratio == pytest.approx((0.05 * 2) / (0.02 * 3))


def test_a_cut_link_brings_the_actuator_to_rest_and_its_return_ramps() -> None:
    under_test, sender = display(), Sender()
    run(under_test, sender, 0, 1500)
    assert under_test.state == "playing"
    cut = run(under_test, None, 1500, 1700)
    assert max(cut[150:]) < 1e-3
    assert under_test.state == "stale"
    sender.sent += 200
    back = run(under_test, sender, 1700, 3000)
    assert max(back[:100]) < 0.1
    assert back[-1] == pytest.approx(0.3, abs=1e-3)
    account = under_test.receiver.account()
    assert account.lost == 200
    assert account.sent == account.played + account.late + account.lost


def test_the_end_of_the_stream_is_played_out_and_accounted_for() -> None:
    under_test, sender = display(), Sender()
    run(under_test, sender, 0, 1500)
    assert not under_test.over
    sender.sent += 10
    under_test.on_control(encode_control(Bye(7, sender.sent)), 1500 * MS)
    assert not under_test.over
    # TCP may still repeat the last samples.
    run(under_test, None, 1500, 4900)
    assert not under_test.over
    run(under_test, None, 4900, 5100)
    assert under_test.over
    samples = under_test.summary().samples
    assert samples.lost == 10
    assert samples.sent is not None
    assert samples.sent + (samples.before_joining or 0) == sender.sent
    # Without a missing sample the wait is shorter.
    under_test, sender = display(), Sender()
    run(under_test, sender, 0, 1500)
    under_test.on_control(encode_control(Bye(7, sender.sent)), 1500 * MS)
    run(under_test, None, 1500, 2100)
    assert under_test.over
    assert under_test.summary().samples.lost == 0


SOFT = ElasticLayer(young_modulus_pa=1e-3, thickness_m=1e-9)
NOT_FINITE = (math.nan, math.inf, -math.inf)
FORCES_N = (*NOT_FINITE, 1e308, -1e308, 5e-324, 1e30, -1e30, 100, -100, 3.4e38)


@pytest.mark.parametrize(
    ("force_n", "layer"),
    [*((force_n, ElasticLayer()) for force_n in FORCES_N), (0.3, SOFT)],
)
def test_no_force_or_layer_of_a_peer_passes_the_limit(force_n: float, layer: ElasticLayer) -> None:
    under_test = display()
    sender = Sender(stream=description(layer=layer, bytes_per_sample=8))
    felt = run(under_test, sender, 0, 3000, force_n)
    assert min(felt) >= 0
    assert max(felt) <= LIMIT_N
    assert 0 < under_test.contactors[0].force_ratio < math.inf
    # A frame with a sample that is not finite, or beyond 1 MN, is counted and not played.
    assert bool(under_test.receiver.rejected["not_finite"]) != (abs(force_n) < 1e6)


EXTREMES = [0, 1, -1, 2**31, 2**40 - 1, 2**53, 2**62, -(2**62), 2**63 - 1, -(2**63)]
extreme = st.sampled_from(EXTREMES) | st.integers(-(2**63), 2**63 - 1)
position = extreme.filter(lambda number: number >= 0)
hostile_message = st.one_of(
    st.builds(ClockReply, st.just(7), extreme, extreme, extreme).map(encode_control),
    st.builds(Bye, st.just(7), position).map(encode_control),
    st.builds(Welcome, position, position, st.just(description())).map(encode_control),
)
hostile_frame = st.builds(
    lambda first, t_ns, force_n: encode_frame(
        Frame(7, first, t_ns, MS, np.full((5, 1), force_n, "<f4"))
    ),
    position,
    extreme,
    st.floats(allow_nan=False, allow_infinity=False, width=32),
)


@settings(max_examples=20)
@given(st.integers(0, 300), st.lists(st.tuples(st.booleans(), hostile_message, hostile_frame)))
def test_any_numbers_of_a_peer_leave_loop_and_telemetry_working(
    good_ms: int, messages: list[tuple[bool, bytes, bytes]]
) -> None:
    under_test, writer = display(), TraceWriter()
    under_test.take_ticks = writer.add
    run(under_test, Sender(), 0, good_ms)
    for number, (is_frame, message, frame) in enumerate(messages):
        now_ns = (good_ms + 20 * number) * MS
        if is_frame:
            under_test.on_frame(frame, now_ns)
        else:
            under_test.on_control(message, now_ns)
        for tick in range(20):
            felt = under_test.tick(now_ns + tick * MS)
            assert 0 <= felt.felt_n <= LIMIT_N
            under_test.requests(now_ns + tick * MS)
        under_test.close_block()
        read_trace(writer.rest() or b"")
        read_status(under_test.pack_status(under_test.summary(), final=False))


@pytest.mark.parametrize("claimed_ns", EXTREMES)
@pytest.mark.parametrize("drift", [0, 1000])
def test_any_clock_of_a_peer_leaves_loop_and_telemetry_working(claimed_ns: int, drift: int) -> None:
    under_test, writer = display(), TraceWriter()
    under_test.take_ticks = writer.add
    under_test.on_control(encode_control(Welcome(7, 0, description())), 0)
    for ms in range(1000):
        now_ns = ms * MS
        t_ns = min(max(claimed_ns + drift * now_ns, -(2**63)), 2**63 - 1)
        for request in under_test.requests(now_ns):
            if isinstance(request, ClockRequest):
                reply = msgpack.packb([2, "clock", 7, now_ns, t_ns, t_ns])
                under_test.on_control(reply, now_ns)
        if ms % 5 == 0:
            frame = Frame(7, ms, t_ns, MS, np.full((5, 1), 0.3, "<f4"))
            under_test.on_frame(encode_frame(frame), now_ns)
        under_test.tick(now_ns)
        if (trace := writer.rest()) is not None:
            read_trace(trace)
    read_status(under_test.pack_status(under_test.summary(), final=False))
