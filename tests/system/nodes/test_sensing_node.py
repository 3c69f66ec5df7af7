import itertools
import secrets
import signal
import socket
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zmq

from protocol.sockets import Context, control_address
from protocol.wire.messages import (
    Bye,
    ClockReply,
    ClockRequest,
    DisplayReport,
    Hello,
    Welcome,
    decode_control,
    decode_frame,
    encode_control,
)
from sensing_node.control_server import MAX_CLIENTS
from telepulse.processes import HOST
from tests.support.log_lines import refused, strays
from tests.support.nodes import RADIAL, process, read_json, run, run_python
from tests.support.sensing_client import PATIENCE_MS, Client

MODULE = "sensing_node.cli"


@pytest.fixture
def client(address: str) -> Iterator[Client]:
    with closing(Client(address)) as client:
        yield client


def end(node: "subprocess.Popen[str]", number: int = signal.SIGTERM) -> str:
    """End a node by a signal; return its log."""
    node.send_signal(number)
    _, errors = node.communicate(timeout=PATIENCE_MS / 1000)
    assert node.returncode == 0
    assert strays(errors) == ""
    return errors


def scene_file(folder: Path, source: str, **keys: str) -> Path:
    path = folder / "scene.toml"
    lines = [f'{key} = "{value}"' for key, value in keys.items()]
    path.write_text("\n".join(["[sensing]", *lines, "[sensing.source]", source]), "utf-8")
    return path


def test_a_stream_from_hello_to_bye(address: str, client: Client, tmp_path: Path) -> None:
    summary = tmp_path / "summary.json"
    arguments = ("--bind", address, "--seconds", "1", "--json", str(summary))
    with process(MODULE, str(RADIAL), *arguments) as node:
        welcome = client.join()
        stream = welcome.description
        assert (stream.name, stream.period_ns, stream.batch) == ("radial pulse", 1_000_000, 5)
        before_ns = time.perf_counter_ns()
        clock = client.ask(ClockRequest(12_345))
        after_ns = time.perf_counter_ns()
        assert isinstance(clock, ClockReply)
        assert (clock.session, clock.t1_ns) == (welcome.session, 12_345)
        assert before_ns <= clock.t2_ns <= clock.t3_ns <= after_ns
        bye = client.bye()
        frames = client.frames_until(bye.samples_sent)
        assert node.wait(PATIENCE_MS / 1000) == 0
    assert bye == Bye(welcome.session, 1000)
    assert {frame.session for frame in frames} == {welcome.session}
    for frame, following in itertools.pairwise(frames):
        assert following.first_sample == frame.first_sample + len(frame.values)
        assert following.t_first_ns == frame.t_first_ns + len(frame.values) * stream.period_ns
    assert all(frame.values.dtype == np.float32 for frame in frames)
    force_n = np.concatenate([frame.values for frame in frames])
    assert 0.1 < force_n.min() < force_n.max() < 0.7
    result = read_json(summary)
    assert result["samples"]["sent"] == 1000
    assert result["rejected"] == {}


@pytest.mark.parametrize(
    ("rate", "batch", "seconds", "sent"),
    [
        ("1 kHz", "7 ms", "0.5", 500),
        ("1 kHz", "1 s", "0.3", 300),
        ("10 Hz", "5 ms", "0.5", 5),
        ("100 kHz", "5 ms", "0.2", 20_000),
    ],
)
def test_exactly_the_samples_of_the_requested_seconds_are_sent(
    address: str, tmp_path: Path, rate: str, batch: str, seconds: str, sent: int
) -> None:
    scene = scene_file(tmp_path, f'kind = "synthetic"\nrate = "{rate}"', batch=batch)
    summary = tmp_path / "summary.json"
    arguments = ("--bind", address, "--seconds", seconds, "--json", str(summary))
    assert run(MODULE, str(scene), *arguments).returncode == 0
    assert read_json(summary)["samples"]["sent"] == sent


def test_the_chains_delay_and_samples_beyond_the_adcs_range_are_reported(
    address: str, tmp_path: Path
) -> None:
    # 5 mV are 0.114 N at Fig. 4's sensitivity: below all of the pulse.
    chain = "[sensing.conditioning]\nanti_alias = '40 Hz'\nadc_bits = 16\nadc_range = '5 mV'"
    scene = scene_file(tmp_path, f'kind = "synthetic"\n{chain}')
    summary = tmp_path / "summary.json"
    arguments = ("--bind", address, "--seconds", "0.3", "--json", str(summary))
    result = run(MODULE, str(scene), *arguments)
    assert result.returncode == 0
    assert read_json(summary)["faults"] == ["300 samples beyond the ADC's range"]
    assert read_json(summary)["limited"]["adc"] == {"times": 1, "seconds": 0.3, "share": 1.0}
    assert "ADC range 1 time, 0.3 s (100.0 % of the run)" in result.stdout
    assert "300 samples beyond the ADC's range" in result.stdout
    assert "delays the pulse by 10.5 ms" in result.stderr


@pytest.mark.parametrize("length", [1003, 1000])
def test_a_recording_played_once_is_sent_to_its_last_sample(
    address: str, client: Client, tmp_path: Path, length: int
) -> None:
    # A triangle of 0.4 N: a column that only rises is refused as one of times.
    wave_mn = np.abs(np.arange(length) % 400 - 200) * 2.0
    np.save(tmp_path / "pulse.npy", wave_mn)
    keys = 'kind = "recording"\npath = "pulse.npy"\nrate = "1 kHz"\nunit = "mN"\nrepeat = "once"'
    with process(MODULE, str(scene_file(tmp_path, keys)), "--bind", address) as node:
        client.join()
        assert client.bye().samples_sent == length
        frames = client.frames_until(length)
        assert node.wait(PATIENCE_MS / 1000) == 0
    force_n = np.concatenate([frame.values[:, 0] for frame in frames])
    np.testing.assert_allclose(force_n, wave_mn[frames[0].first_sample :] * 1e-3, rtol=1e-6)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("batch", ["5 ms", "1 s"])
def test_a_signal_ends_the_stream_after_all_due_samples(
    address: str, client: Client, tmp_path: Path, number: int, batch: str
) -> None:
    scene = scene_file(tmp_path, 'kind = "synthetic"', batch=batch)
    with process(MODULE, str(scene), "--bind", address) as node:
        client.join()
        first, due = decode_frame(client.data.recv()), 0
        while due < first.first_sample + len(first.values) + 10:
            clock = client.ask(ClockRequest(0))
            assert isinstance(clock, ClockReply)
            due = first.first_sample + (clock.t2_ns - first.t_first_ns) // first.period_ns + 1
        end(node, number)
        bye = client.bye()
        assert bye.samples_sent >= due
        last = client.frames_until(bye.samples_sent)[-1]
    assert last.first_sample + len(last.values) == bye.samples_sent


def test_displays_of_any_name_may_leave_and_return(address: str, client: Client) -> None:
    with process(MODULE, str(RADIAL), "--bind", address) as node:
        session = client.join("anna's").session
        with closing(Client(address)) as other:
            assert other.join("[/] ☠").session == session
            first = decode_frame(other.data.recv())
        with closing(Client(address)) as again:
            welcome = again.join("[bold] :smile:")
            frame = decode_frame(again.data.recv())
            assert {first.session, welcome.session, frame.session} == {session}
            assert frame.first_sample > first.first_sample
            assert welcome.samples_sent > first.first_sample
            report = DisplayReport(session, "anna's", 900, 70, 20, 3, 1.0, 2.0, 40.0, 0.001)
            client.control.send(encode_control(report))
            client.ask(ClockRequest(0))
            log = end(node)
            assert client.bye() == again.bye()
    # The log escapes names of other characters.
    for name in ("anna's", r"[/] \u2620", "[bold] :smile:"):
        assert f"{name} joined\n" in log
    assert "anna's last reported 900 played, 70 predicted, 20 late, 3 lost" in log


def interrupt(node: "subprocess.Popen[str]") -> str:
    """Send Ctrl-C to a node; return its next line of the log that names a wait or a report."""
    assert node.stderr is not None
    node.send_signal(signal.SIGINT)
    return next(line for line in node.stderr if "ending: " in line or "last reported" in line)


def test_a_display_that_does_not_confirm_the_end_is_waited_for_until_a_second_signal(
    address: str, client: Client
) -> None:
    with process(MODULE, str(RADIAL), "--bind", address, "--quiet", "--log-level", "info") as node:
        client.join()
        begin_s = time.monotonic()
        assert interrupt(node).endswith(
            "INFO ending: waiting up to 3 s for 1 display to confirm the end of the stream (raw);"
            " Ctrl-C again ends at once\n"
        )
        node.send_signal(signal.SIGINT)
        assert node.wait(PATIENCE_MS / 1000) == 0
        # A wait to its end takes 3 s.
        assert time.monotonic() - begin_s < 2.5


def test_a_display_whose_connection_is_closed_is_waited_for_a_shorter_time(address: str) -> None:
    with process(MODULE, str(RADIAL), "--bind", address, "--quiet", "--log-level", "info") as node:
        with closing(Client(address)) as killed:
            killed.join()
        time.sleep(0.5)
        assert "waiting up to 1 s for 1 display" in interrupt(node)
        assert node.wait(PATIENCE_MS / 1000) == 0


def test_a_display_that_was_ended_has_left_and_is_not_waited_for(address: str) -> None:
    display = ("display_node.cli", str(RADIAL), "--connect", address)
    with process(MODULE, str(RADIAL), "--bind", address, "--quiet", "--log-level", "info") as node:
        assert node.stderr is not None
        with process(*display) as left:
            assert left.stdout is not None
            name = next(line for line in node.stderr if " joined" in line).split()[-2]
            # A display that has no welcome yet has nothing to leave.
            assert any(line.startswith("playing:") for line in left.stdout)
            left.send_signal(signal.SIGINT)
            left.wait(PATIENCE_MS / 1000)
        assert next(line for line in node.stderr if name in line).endswith(f"INFO {name} left\n")
        assert "ending: " not in end(node, signal.SIGINT)


HELLO = encode_control(Hello("raw"))
GARBAGE: list[tuple[list[bytes], str]] = [
    ([b""], "truncated"),
    ([HELLO[:-1]], "truncated"),
    ([b"\xc1" * 100], "not_msgpack"),
    ([b"\x07"], "malformed"),
    ([bytes(100_000)], "oversized"),
    ([HELLO, b""], "malformed"),
    ([HELLO] * 1000, "malformed"),
    ([encode_control(ClockReply(1, 1, 1, 1))], "unexpected"),
    ([encode_control(Bye(1, 1))], "session"),
    ([encode_control(DisplayReport(1, "raw", 1, 0, 0, 0, 0.0, 0.0, 0.0, 0.0))], "session"),
]
RANDOM_SIZES = (1, 10, 100, 1000, 60_000)


def test_garbage_is_counted_and_harms_nothing(address: str, client: Client, tmp_path: Path) -> None:
    summary = tmp_path / "summary.json"
    arguments = ("--bind", address, "--json", str(summary))
    with process(MODULE, str(RADIAL), *arguments) as node:
        client.join()
        for parts, _ in GARBAGE:
            client.control.send_multipart(parts)
        for size in RANDOM_SIZES:
            client.control.send(secrets.token_bytes(size))
        # Requests are answered in order, so all of the garbage was read.
        assert isinstance(client.ask(ClockRequest(0)), ClockReply)
        first = decode_frame(client.data.recv())
        break_connections(address)
        following = client.frames_until(first.first_sample + 300)
        assert following[0].first_sample == first.first_sample + len(first.values)
        end(node)
    rejected: dict[str, int] = read_json(summary)["rejected"]
    assert sum(rejected.values()) == len(GARBAGE) + len(RANDOM_SIZES)
    for cause, count in Counter(cause for _, cause in GARBAGE).items():
        assert rejected[cause] >= count


def test_a_display_of_another_version_is_refused_in_one_line(address: str, client: Client) -> None:
    with process(MODULE, str(RADIAL), "--bind", address) as node:
        for _ in range(3):
            client.control.send(msgpack.packb([1, "hello", "old"]))
            assert isinstance(decode_control(client.control.recv()), Welcome)
        errors = end(node)
    assert errors.count("refused: the peer has version 1 of the protocol, this node version 2") == 1


def break_connections(address: str) -> None:
    """Send bytes that are not ZeroMQ's, and a message above the socket's limit."""
    port = int(address.rpartition(":")[2])
    for each in (port, port + 1):
        with socket.create_connection((HOST, each)) as raw:
            raw.sendall(b"GET / HTTP/1.1\r\n\r\n" + bytes(1000))
    with closing(Client(address)) as huge:
        huge.join()
        monitor = huge.control.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        huge.control.send(bytes(2_000_000))
        assert monitor.poll(PATIENCE_MS)
        huge.control.disable_monitor()


@pytest.mark.parametrize("taken", ["data", "control"])
def test_a_port_in_use_is_refused_in_one_line(address: str, taken: str) -> None:
    held = address if taken == "data" else control_address(address)
    with socket.create_server((HOST, int(held.rpartition(":")[2]))):
        line = refused(MODULE, str(RADIAL), "--bind", address)
    assert line.startswith(f"sensing-node: cannot bind {held}: ")
    assert "in use" in line


RECORDING = 'kind = "recording"\npath = "{}"\nrate = "1 kHz"\nunit = "N"'


@pytest.mark.parametrize(
    ("source", "arguments", "line"),
    [
        *(
            (None, ("--bind", wrong), f"{wrong}: ")
            for wrong in ("localhost:5555", "tcp://*:65535", "udp://h:1", "ipc://")
        ),
        (None, ("none.toml",), "none.toml: no such scene file\n"),
        (RECORDING.format("none.csv"), (), "{}/none.csv: no such recording\n"),
        (
            RECORDING.format("pulse.npy"),
            (),
            '{}/pulse.npy: reaches 400 N in unit "N", and a pulse stays below 20 N;'
            ' set unit = "mN" if the values are in mN\n',
        ),
    ],
)
def test_a_wrong_address_scene_or_recording_is_refused_in_one_line(
    tmp_path: Path, source: str | None, arguments: tuple[str, ...], line: str
) -> None:
    np.save(tmp_path / "pulse.npy", 300 + 100 * np.sin(np.arange(100)))
    scene = str(RADIAL if source is None else scene_file(tmp_path, source))
    arguments = arguments if arguments == ("none.toml",) else (scene, *arguments)
    assert refused(MODULE, *arguments).startswith(f"sensing-node: {line.format(tmp_path)}")


def test_a_scene_without_conditioning_does_not_load_scipy() -> None:
    code = (
        "import sys; from pathlib import Path; import sensing_node.cli;"
        "from protocol.config.scene import load_section; from sensing_node.scene import *;"
        f"scene = load_section(Path({str(RADIAL)!r}), 'sensing', SensingScene);"
        "build_source(scene, Path()).take(10); print('scipy.signal' in sys.modules)"
    )
    assert run_python("-c", code).stdout == "False\n"


@pytest.mark.parametrize("confirmed", [True, False])
def test_the_node_waits_for_a_limited_time_until_each_display_has_the_whole_stream(
    address: str, client: Client, confirmed: bool
) -> None:
    with process(MODULE, str(RADIAL), "--bind", address, "--seconds", "0.5") as node:
        client.join()
        bye = decode_control(client.control.recv())
        assert isinstance(bye, Bye)
        if confirmed:
            # A display that joins now receives the bye as well.
            with closing(Client(address)) as other:
                other.join("other")
                assert other.bye() == bye
            assert node.poll() is None
            client.control.send(encode_control(bye))
        assert node.wait(PATIENCE_MS / 1000) == 0


TOO_MANY = 5


def test_a_full_node_answers_its_displays_and_no_further_one(
    context: Context, address: str
) -> None:
    # A relay puts an address before the message of each display.
    relay = context.socket(zmq.DEALER)
    relay.setsockopt(zmq.RCVTIMEO, PATIENCE_MS)
    relay.connect(control_address(address))
    with process(MODULE, str(RADIAL), "--bind", address) as node:
        for number in range(MAX_CLIENTS + TOO_MANY):
            display = b"\0%04d" % number
            relay.send_multipart([display, encode_control(Hello(f"display {number}"))])
            if number >= MAX_CLIENTS:
                continue
            sender, welcome = relay.recv_multipart()
            assert sender == display
            message = decode_control(welcome)
            assert isinstance(message, Welcome)
        relay.send_multipart([b"\0%04d" % 0, encode_control(ClockRequest(7))])
        sender, reply = relay.recv_multipart()
        assert sender == b"\0%04d" % 0
        assert isinstance(decode_control(reply), ClockReply)
        # So that the node does not wait for them at its end.
        bye = encode_control(Bye(message.session, 0))
        for number in range(MAX_CLIENTS):
            relay.send_multipart([b"\0%04d" % number, bye])
        node.send_signal(signal.SIGTERM)
        output, errors = node.communicate(timeout=PATIENCE_MS / 1000)
    assert (node.returncode, strays(errors)) == (0, "")
    assert errors.count("no further one is answered") == 1
    assert f"{TOO_MANY} too_many_displays" in output
