import itertools
import signal
import subprocess
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from protocol.wire.messages import (
    Bye,
    ClockReply,
    ClockRequest,
    decode_control,
    decode_frame,
    encode_control,
)
from tests.support.log_lines import messages, strays
from tests.support.nodes import RADIAL, process, read_json
from tests.support.sensing_client import PATIENCE_MS, Client

MODULE = "sensing_node.cli"


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


def test_a_display_that_joins_and_leaves_is_logged_by_its_name(
    address: str, client: Client
) -> None:
    with process(MODULE, str(RADIAL), "--bind", address) as node:
        # A display that has connected again may send a request first.
        assert isinstance(client.ask(ClockRequest(1)), ClockReply)
        client.join("anna")
        assert isinstance(client.ask(ClockRequest(2)), ClockReply)
        client.join("anna")
        log = messages(end(node))
    assert [line for line in log if line.endswith((" joined", " left"))] == ["anna joined"]


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


def test_a_recording_played_once_is_sent_to_its_last_sample(
    address: str, client: Client, tmp_path: Path
) -> None:
    # No whole number of frames.
    length = 1003
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


@pytest.mark.parametrize(("number", "batch"), [(signal.SIGTERM, "5 ms"), (signal.SIGINT, "1 s")])
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


def test_the_node_waits_until_each_display_has_the_whole_stream(
    address: str, client: Client
) -> None:
    with process(MODULE, str(RADIAL), "--bind", address, "--seconds", "0.5") as node:
        client.join()
        bye = decode_control(client.control.recv())
        assert isinstance(bye, Bye)
        # A display that joins now receives the bye as well.
        with closing(Client(address)) as other:
            other.join("other")
            assert other.bye() == bye
        assert node.poll() is None
        client.control.send(encode_control(bye))
        assert node.wait(PATIENCE_MS / 1000) == 0
