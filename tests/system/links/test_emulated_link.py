"""Real TCP of the kernel over the emulated link."""

import os
import signal
import socket
import time
from pathlib import Path

import pytest

from telepulse.simulation.link_scene import parse_link
from tests.support.netem import EmulatedLink, EmulatorError, emulate, unavailable
from tests.support.nodes import known
from tests.support.tcp import PORT, connected, needs_emulator, stream

MS = 1_000_000


def round_trips_ms(link: EmulatedLink, count: int, number: int = 0) -> list[float]:
    """Return the durations of round trips over one of the links."""
    trips_ms = []
    with connected(link, number) as (sensing, display):
        for _ in range(count):
            began_ns = time.perf_counter_ns()
            display.sendall(b"?")
            sensing.sendall(sensing.recv(1))
            assert display.recv(1) == b"?"
            trips_ms.append((time.perf_counter_ns() - began_ns) / MS)
    return trips_ms


@pytest.mark.smoke
@needs_emulator
def test_a_round_trip_takes_the_time_of_the_model() -> None:
    with emulate(parse_link("delay=20ms")) as link:
        trips_ms = round_trips_ms(link, 20)
    # Never early; a busy machine adds to the least of 20 too. Twice the delay would be 80 ms.
    assert 40 <= min(trips_ms) < 80
    assert known(link.carried).lost == 0
    assert known(link.carried).packets >= 2 * 20


@needs_emulator
def test_a_lost_packet_holds_up_what_follows_and_nothing_is_missing() -> None:
    with (
        emulate(parse_link("delay=20ms,loss=5%")) as link,
        connected(link) as (sensing, display),
    ):
        sent_ns, read_ns = stream(sensing, display, messages=200, step_ms=5)
    delays_ms = [(read - sent) / MS for sent, read in zip(sent_ns, read_ns, strict=True)]
    assert min(delays_ms) >= 20
    # The lost packet, the acknowledgement of a later one, the retransmission: three delays.
    assert max(delays_ms) >= 3 * 20
    assert known(link.carried).lost > 0


@needs_emulator
def test_nothing_passes_a_cut_and_all_comes_after_it() -> None:
    with (
        emulate(parse_link("delay=20ms,cut.from=0.8s,cut.for=0.6s")) as link,
        connected(link) as (sensing, display),
    ):
        sent_ns, read_ns = stream(sensing, display, messages=120, step_ms=10)
    from_ms, to_ms = 800 + 20, 1400 + 20
    times_ms = [(read - link.began_ns) / MS for read in read_ns]
    # A message may be read after its arrival, and much later on a busy machine.
    assert not [time for time in times_ms if from_ms + 300 < time < to_ms]
    sent_in_it = sum(from_ms - 20 < (sent - link.began_ns) / MS < to_ms - 20 for sent in sent_ns)
    assert sent_in_it > 0
    assert sum(time >= to_ms for time in times_ms) >= sent_in_it


@needs_emulator
def test_several_links_between_the_same_two_each_have_their_own_impairments() -> None:
    scenes = parse_link("delay=20ms"), parse_link("delay=60ms"), parse_link("loss=1")
    with emulate(*scenes) as link:
        assert len(set(link.sensing.addresses) | set(link.display.addresses)) == 2 * len(scenes)
        trips_ms = [round_trips_ms(link, 10, number) for number in (0, 1)]
        with link.display.entered(), socket.socket() as caller:
            caller.settimeout(0.3)
            with pytest.raises(TimeoutError):
                caller.connect((link.sensing.addresses[2], PORT))
    assert 40 <= min(trips_ms[0]) < 120 <= min(trips_ms[1])
    assert known(link.carried).lost >= 1


@needs_emulator
def test_nothing_is_left_behind_though_it_ends_with_an_error() -> None:
    before, others = open_descriptors(), children()
    home = os.readlink("/proc/thread-self/ns/net")
    forwarders: set[int] = set()

    def fail_within() -> None:
        with emulate(parse_link("")) as link, link.sensing.entered():
            forwarders.update(children() - others)
            assert os.readlink("/proc/thread-self/ns/net") != home
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_within()
    assert os.readlink("/proc/thread-self/ns/net") == home
    assert open_descriptors() == before
    assert forwarders - children() == forwarders != set()


@needs_emulator
def test_a_forwarder_that_does_not_start_or_is_killed_is_reported() -> None:
    with (
        pytest.raises(EmulatorError, match=r"forwarder.*ValueError.*none"),
        emulate(parse_link(""), seed="none"),  # type: ignore[arg-type]
    ):
        pytest.fail("there is no such seed")
    before = children()
    with (
        pytest.raises(EmulatorError, match="forwarder of the emulated link ended"),
        emulate(parse_link("")),
    ):
        os.kill((children() - before).pop(), signal.SIGKILL)


def test_without_root_the_reason_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert unavailable() == "the link emulator needs root"


def open_descriptors() -> set[str]:
    """Return the descriptors of this process, each with its target."""
    folder = "/proc/self/fd"
    paths = (f"{folder}/{name}" for name in os.listdir(folder))
    return {f"{path} {os.readlink(path)}" for path in paths if os.path.exists(path)}


def children() -> set[int]:
    """Return the child processes of this thread."""
    path = Path("/proc/thread-self/children")
    return {int(number) for number in path.read_text(encoding="ascii").split()}
