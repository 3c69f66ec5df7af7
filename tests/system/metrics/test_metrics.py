"""Nodes that serve metrics: real processes, real HTTP."""

import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

import pytest
from prometheus_client import CollectorRegistry, make_wsgi_app
from prometheus_client.parser import text_string_to_metric_families

from protocol.host.child_process import ChildProcess
from protocol.summary.figures import Surface, figures_on
from protocol.summary.phrases import COUNT
from telepulse.metrics import server as http
from telepulse.metrics.server import MAX_REQUESTS, MetricsHTTPServer
from tests.support.keyring import Keyring
from tests.support.log_lines import unusual
from tests.support.nodes import RADIAL, free_address, known, process, read_json
from tests.support.waiting import PATIENCE_S, until

DISPLAY, SENSING = "display_node.cli", "sensing_node.cli"
Labels = tuple[tuple[str, str], ...]


class Served:
    """A node and the page of its metrics."""

    def __init__(self, node: ChildProcess) -> None:
        line = node.read_line(3 * PATIENCE_S, from_stderr=True)
        assert " INFO metrics on http://" in line, line
        self.node, self.url = node, line.split()[-1]
        children = (
            Path(f"/proc/{node.pid}/task/{node.pid}/children").read_text(encoding="utf-8").split()
        )
        (self.server,) = map(int, children)

    def scrape(self) -> dict[tuple[str, Labels], float]:
        with urlopen(self.url, timeout=PATIENCE_S) as answer:
            text = answer.read().decode()
        return {
            (sample.name, tuple(sorted(sample.labels.items()))): sample.value
            for family in text_string_to_metric_families(text)
            for sample in family.samples
        }

    def figure(self, name: str, **labels: str) -> float | None:
        return self.scrape().get(("telepulse_" + name, tuple(sorted(labels.items()))))

    def gone(self) -> bool:
        """Return whether the server has ended."""
        try:
            self.scrape()
        except (URLError, OSError):
            return not Path(f"/proc/{self.server}").exists()
        return False


@contextmanager
def served(module: str, *arguments: str) -> Iterator[Served]:
    with process(module, str(RADIAL), *arguments, "--metrics", "0") as node:
        yield Served(node)


def display(address: str, *more: str) -> tuple[str, ...]:
    return (*("--connect", address, "--no-screen"), *more)


def test_both_nodes_serve_what_they_sum_up(tmp_path: Path) -> None:
    address, jsons = free_address(), [tmp_path / "display.json", tmp_path / "sensing.json"]
    with served(DISPLAY, *display(address, "--json", str(jsons[0]))) as finger:
        until(lambda: finger.figure("state", telepulse_state="waiting") == 1)
        # Without frames they have no delay.
        assert finger.figure("one_way_delay_max_seconds") is None
        with served(SENSING, "--bind", address, "--json", str(jsons[1])) as wrist:
            until(lambda: finger.figure("state", telepulse_state="playing") == 1)
            # The first status may come before the first frame.
            until(lambda: wrist.figure("displays") == 1 and wrist.figure("samples_sent_total"))
            sent = wrist.figure("samples_sent_total")
            # A heart rate needs two beats.
            until(lambda: finger.figure("heart_rate_hertz") is not None)
            wrist.node.terminate()
            assert wrist.node.wait(PATIENCE_S) == 0
            until(wrist.gone)
        until(lambda: finger.figure("state", telepulse_state="ended") == 1)
        sensed = read_json(jsons[1])["samples"]["sent"]
        until(
            lambda: (
                (finger.figure("samples_sent_total") or 0)
                + (finger.figure("samples_before_joining") or 0)
                == sensed
            )
        )
        last = finger.scrape()
        finger.node.terminate()
        assert finger.node.wait(PATIENCE_S) == 0
        until(finger.gone)
    assert 0 < known(sent) <= sensed
    summary, compared = read_json(jsons[0]), 0
    for figure in figures_on(Surface.METRICS):
        # The other figures changed until the display's end.
        if figure.key.partition(".")[0] in ("samples", "frames", "one_way_delay_ms", "rejected"):
            value = figure.value(summary)
            if figure.label or value is None:
                assert not value
                continue
            suffix = "_total" if figure.counter else ""
            name, labels = f"telepulse_{figure.metric}{suffix}", tuple(figure.labels.items())
            base = (figure.unit or COUNT).base
            assert last[name, labels] == pytest.approx(value * base), figure.key
            compared += 1
    assert compared > 9


def test_a_killed_server_is_reported_and_the_node_goes_on(tmp_path: Path) -> None:
    json = tmp_path / "sensing.json"
    with served(SENSING, "--bind", free_address(), "--json", str(json)) as wrist:
        until(lambda: wrist.figure("up") == 1)
        os.kill(wrist.server, signal.SIGKILL)
        while "ended" not in (line := wrist.node.read_line(3 * PATIENCE_S, from_stderr=True)):
            pass
        wrist.node.terminate()
        assert wrist.node.wait(PATIENCE_S) == 0
        _, errors = wrist.node.communicate()
    assert "WARNING the metrics server has ended with status -9" in line
    assert unusual(errors) == ""
    assert read_json(json)["samples"]["sent"] > 0


def test_telemetry_with_keys_is_read_by_the_own_server(tmp_path: Path) -> None:
    ring, address = Keyring(tmp_path / "keys"), free_address()
    ring.allow("notes")
    keys = ("--key", ring.path("finger"), "--peer", ring.path("wrist", "pub"))
    telemetry = ("--telemetry", free_address().replace("127.0.0.1", "*"))
    with served(DISPLAY, *display(address, *keys, *telemetry)) as finger:
        until(lambda: finger.figure("up") == 1)


@contextmanager
def serving() -> Iterator[MetricsHTTPServer]:
    server = MetricsHTTPServer("127.0.0.1", 0, make_wsgi_app(CollectorRegistry()))
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def answers(server: MetricsHTTPServer) -> bool:
    try:
        with urlopen(f"http://127.0.0.1:{server.server_port}/", timeout=PATIENCE_S) as answer:
            return bool(answer.status == 200)
    except (URLError, OSError):
        return False


def test_connections_that_send_nothing_are_few_and_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http._Handler, "timeout", 1.0)
    with serving() as server, ExitStack() as held:
        threads = threading.active_count()
        for _ in range(5 * MAX_REQUESTS):
            held.enter_context(socket.create_connection(("127.0.0.1", server.server_port)))
        assert threading.active_count() - threads <= MAX_REQUESTS
        until(lambda: answers(server))
