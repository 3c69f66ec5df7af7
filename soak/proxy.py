"""Links over the loopback interface, without root: `python -m soak.proxy SEED NEAR ADDRESS...`.

A proxy of TCP connections: bytes read from one are written to the other at the time given by the
link's model. Lost bytes arrive later, as after TCP's retransmission; a cut delays everything. A
line on standard input, a link's number and its new properties, changes that link; the end of
standard input ends the proxy.
"""

import asyncio
import sys
import time
from contextlib import suppress

from protocol.sockets import control_address
from telepulse.simulation.link_model import Direction
from telepulse.simulation.link_scene import LinkScene, parse_link

REPEAT_NS = 200_000_000
CHUNK_BYTES = 16_384
# Bytes in transit at most; then the sender blocks, as on a real link.
WINDOW = 256


class Link:
    """A link with both directions, for all its connections. cut: nothing passes."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self.change(LinkScene())

    def change(self, scene: LinkScene) -> None:
        """Set its properties."""
        self.cut = scene.loss == 1.0
        self._there, self._back = (Direction(scene, self._seed + way) for way in (0, 1))

    def due_ns(self, back: bool, size_bytes: int) -> int:
        """Return the arrival of bytes that are sent now, retransmissions included."""
        now_ns = sent_ns = time.perf_counter_ns()
        way = self._back if back else self._there
        while (due_ns := way.arrival_ns(sent_ns, size_bytes)) is None:
            sent_ns += REPEAT_NS
            if sent_ns - now_ns > REPEAT_NS:
                return sent_ns
        return due_ns


async def main(arguments: list[str]) -> None:
    """Serve until standard input ends."""
    seed, near, *addresses = arguments
    links = [Link(int(seed) + 2 * number) for number in range(len(addresses))]
    for link, address in zip(links, addresses, strict=True):
        for bound, goal in ((address, near), (control_address(address), control_address(near))):
            await _serve(link, bound, goal)
    print("ready", flush=True)
    loop = asyncio.get_running_loop()
    while line := await loop.run_in_executor(None, sys.stdin.readline):
        number, _, text = line.strip().partition(" ")
        links[int(number)].change(parse_link(text))


async def _serve(link: Link, bound: str, goal: str) -> None:
    async def connected(near: asyncio.StreamReader, out: asyncio.StreamWriter) -> None:
        try:
            far, to_far = await asyncio.open_connection(*_host_and_port(goal))
        except OSError:
            out.close()
            return
        await asyncio.gather(_carry(link, False, near, to_far), _carry(link, True, far, out))

    await asyncio.start_server(connected, *_host_and_port(bound))


async def _carry(
    link: Link, back: bool, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
) -> None:
    """Forward one direction of a connection until it ends."""
    waiting: asyncio.Queue[tuple[int, bytes]] = asyncio.Queue(WINDOW)
    sender = asyncio.create_task(_write(link, waiting, writer))
    with suppress(OSError):
        while data := await reader.read(CHUNK_BYTES):
            await waiting.put((link.due_ns(back, len(data)), data))
    await waiting.put((time.perf_counter_ns(), b""))
    await sender


async def _write(
    link: Link, waiting: asyncio.Queue[tuple[int, bytes]], writer: asyncio.StreamWriter
) -> None:
    while True:
        due_ns, data = await waiting.get()
        while (wait_ns := due_ns - time.perf_counter_ns()) > 0 or link.cut:
            await asyncio.sleep(max(wait_ns * 1e-9, 0.01))
        if not data:
            break
        # The receiver has closed: the remaining bytes are dropped.
        if not writer.is_closing():
            with suppress(OSError):
                writer.write(data)
                await writer.drain()
    writer.close()
    with suppress(OSError):
        await writer.wait_closed()


def _host_and_port(address: str) -> tuple[str, int]:
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    return host, int(port)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1:]))
