"""Check that a soak leaves nothing behind: processes, namespaces, sockets, files."""

import os
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

MARK = "TELEPULSE_SOAK"


def mark() -> None:
    """Mark this process and its future children with its number."""
    os.environ[MARK] = str(os.getpid())


def namespaces_of(pids: list[int]) -> set[int]:
    """Return the network namespaces of these processes, except this process's."""
    numbers = {number for pid in pids if (number := _namespace(str(pid))) is not None}
    return numbers - {_namespace("self")}


def left_behind(namespaces: set[int], addresses: list[str], folder: str) -> list[str]:
    """Return a line for each thing that remains of a finished soak.

    namespaces: namespaces that it made. addresses: addresses that it used in this namespace.
    """
    return [*_processes(namespaces), *_sockets(addresses), *_files(folder)]


def _processes(namespaces: set[int]) -> Iterator[str]:
    marked = f"{MARK}={os.getpid()}".encode()
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit() or int(entry.name) == os.getpid():
            continue
        with suppress(OSError):  # it has ended
            state, parent = (
                (entry / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()[:2]
            )
            name = (entry / "comm").read_text(encoding="utf-8").strip()
            if state == "Z" and int(parent) == os.getpid():
                yield f"a zombie, {name}"
            elif marked in (entry / "environ").read_bytes().split(b"\0"):
                yield f"a process, {name}"
            if _namespace(entry.name) in namespaces:
                yield f"a process in a namespace of ours, {name}"


def _sockets(addresses: list[str]) -> Iterator[str]:
    for address in addresses:
        host, _, port = address.removeprefix("tcp://").rpartition(":")
        for number in (int(port), int(port) + 1):
            with socket.socket() as probe:
                # As the nodes do when they bind: a socket in TIME_WAIT does not count.
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                try:
                    probe.bind((host, number))
                except OSError:
                    yield f"a socket on {host}:{number}"


def _files(folder: str) -> Iterator[str]:
    if os.path.exists(folder):
        yield f"the folder {folder}"


def _namespace(process: str) -> int | None:
    with suppress(OSError):
        return os.stat(f"/proc/{process}/ns/net").st_ino
    return None
