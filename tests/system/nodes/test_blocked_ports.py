"""What a display says of ports that are blocked, are another program's, or are no more there."""

import select
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest

from protocol.sockets import Context
from protocol.wire.telemetry import Status
from tests.support.live_display import MODULE, await_status, display_arguments, subscribe
from tests.support.nodes import RADIAL, free_address, process
from tests.support.waiting import PATIENCE_S

SENSING = ("sensing_node.cli", str(RADIAL), "--insecure", "--quiet", "--bind")


def port_of(address: str) -> int:
    return int(address.rpartition(":")[2])


def with_port(address: str, port: int) -> str:
    return f"{address.rpartition(':')[0]}:{port}"


@contextmanager
def served(port: int, serve: Callable[[socket.socket], None]) -> Iterator[None]:
    """Serve each connection to a port by a call, and keep it open until the end."""
    with socket.create_server(("127.0.0.1", port)) as listening, ExitStack() as open_ones:
        over = threading.Event()
        listening.settimeout(0.05)

        def accept() -> None:
            while not over.is_set():
                with suppress(OSError):
                    serve(open_ones.enter_context(listening.accept()[0]))

        before = set(threading.enumerate())
        threading.Thread(target=accept).start()
        try:
            yield
        finally:
            over.set()
            for each in set(threading.enumerate()) - before:
                each.join(PATIENCE_S)


def forward(port: int) -> Callable[[socket.socket], None]:
    """Return what forwards a connection to a port of this machine until either end closes."""

    def copy(near: socket.socket) -> None:
        with socket.create_connection(("127.0.0.1", port)) as far, near, suppress(OSError):
            while True:
                for source in select.select([near, far], [], [])[0]:
                    data = source.recv(1 << 16)
                    if not data:
                        return
                    (far if source is near else near).sendall(data)

    def serve(near: socket.socket) -> None:
        near.settimeout(None)
        threading.Thread(target=copy, args=(near,)).start()

    return serve


def keep_silent(_: socket.socket) -> None:
    pass


def await_reason(context: Context, address: str, words: str, folder: Path) -> str:
    """Run a display until it states a reason; return its words until then in one line."""
    telemetry = f"ipc://{folder / 'status'}"
    screen, said = subscribe(context, telemetry), list[str]()

    def has_reason(status: Status) -> bool:
        summary = status.summary
        said.extend(f"{each['text']}; {each['further']}" for each in summary["waiting_for"])
        return words in " ".join(said)

    with process(MODULE, *display_arguments(address, telemetry, "--insecure")):
        try:
            await_status(screen, has_reason)
        finally:
            print(sorted(set(said)))
    return " ".join(said)


@pytest.mark.parametrize("is_silent", [False, True])
@pytest.mark.parametrize("blocked", ["data", "control"])
def test_of_two_ports_the_blocked_one_is_named(
    blocked: str, is_silent: bool, context: Context, tmp_path: Path
) -> None:
    node, given = free_address(), free_address()
    data, control = port_of(given), port_of(given) + 1
    kept, lost = (control, data) if blocked == "data" else (data, control)
    kept_name = "control" if blocked == "data" else "data"
    how = "is accepted, but not answered" if is_silent else "is refused"
    with ExitStack() as stack:
        stack.enter_context(process(*SENSING, node))
        stack.enter_context(served(kept, forward(port_of(node) + kept - data)))
        if is_silent:
            stack.enter_context(served(lost, keep_silent))
        words = f"{given}: {kept_name} on port {kept} is connected, {blocked} on port {lost} {how}"
        said = await_reason(context, given, words, tmp_path)
    assert "open or forward that port" in said
    assert "is no node" not in said


def test_the_control_port_in_place_of_the_data_s_is_named(context: Context, tmp_path: Path) -> None:
    node = free_address()
    given = with_port(node, port_of(node) + 1)
    with process(*SENSING, node):
        said = await_reason(context, given, f"{given} speaks ZeroMQ, but serves no data", tmp_path)
    assert "give the port of the data, which is one below" in said


@pytest.mark.parametrize(
    ("banner", "words"),
    [
        (b"SSH-2.0-OpenSSH_9.2\r\n", "answers, but is no node: it sends 'SSH-2.0-OpenSSH_9.2'"),
        (b"HTTP/1.1 400 Bad Request\r\n", "is no node: it sends 'HTTP/1.1 400 Bad Request'"),
        (b"", "accepts connections, but does not answer"),
    ],
)
def test_another_program_is_named_by_what_it_sends(
    banner: bytes, words: str, context: Context, tmp_path: Path
) -> None:
    given = free_address()
    with served(port_of(given), lambda connection: connection.sendall(banner)):
        said = await_reason(context, given, words, tmp_path)
    assert banner or "is no node:" not in said


def test_a_node_that_was_stopped_is_never_another_program(context: Context, tmp_path: Path) -> None:
    address, telemetry = free_address(), f"ipc://{tmp_path / 'status'}"
    screen, said = subscribe(context, telemetry), list[str]()

    def nobody_listens(status: Status) -> bool:
        said.extend(each["text"] for each in status.summary["waiting_for"])
        return any(text.startswith(f"nobody listens at {address}") for text in said)

    with (
        process(*SENSING, address) as node,
        process(MODULE, *display_arguments(address, telemetry)),
    ):
        await_status(screen, lambda status: status.state == "playing")
        node.kill()
        await_status(screen, nobody_listens)
    assert not any("no node" in text for text in said)


@pytest.mark.parametrize(
    ("zone", "words"),
    [
        ("", "[fe80::1] lacks the interface that leads there: write tcp://[fe80::1%"),
        ("%nope7", "[fe80::1%nope7] no interface here is named nope7: write tcp://[fe80::1%"),
    ],
)
def test_a_link_local_address_without_its_interface_names_those_here(
    zone: str, words: str, context: Context, tmp_path: Path
) -> None:
    said = await_reason(context, f"tcp://[fe80::1{zone}]:5555", words, tmp_path)
    assert ", ".join(name for _, name in socket.if_nameindex()) in said
    assert "nobody listens" not in said
    assert "refused" not in said
