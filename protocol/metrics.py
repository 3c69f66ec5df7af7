"""The option for metrics, which a process beside the node serves."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from protocol.host.sidecar import Sidecar, sidecar_module, start_sidecar
from protocol.sockets import beyond_loopback

MetricsOption = Annotated[
    str | None,
    typer.Option(
        metavar="[ADDRESS:]PORT",
        help="Serve this node's figures to Prometheus over HTTP, on this machine alone unless an"
        " address is given; port 0 picks a free one.",
    ),
]


class MetricsSidecar:
    """What serves a node's figures, once it is told where they are published."""

    def __init__(self, sidecar: Sidecar | None) -> None:
        """None: nothing is served."""
        self._sidecar = sidecar

    def __bool__(self) -> bool:
        return self._sidecar is not None

    def follow(self, telemetry_address: str, key: Path | None = None) -> None:
        """Serve what is published there; key: the node's own, where that needs one."""
        if self._sidecar is not None:
            own = None if key is None else str(key)
            self._sidecar.send(address=telemetry_address, key=own)


@contextmanager
def start_metrics(program: str, where: str | None, console: Console) -> Iterator[MetricsSidecar]:
    """Metrics served at `where` (None: not at all) within a `with`; enter it before anything
    moves. Raises SidecarError where the port is taken or the library is missing."""
    if where is None:
        yield MetricsSidecar(None)
        return
    arguments = ("the server of metrics", sidecar_module("metrics"), program, where)
    with start_sidecar(program, *arguments, log=console.print) as sidecar:
        console.print(f"metrics on {sidecar.ready_message}")
        if beyond_loopback(
            sidecar.ready_message.replace("http", "tcp", 1).removesuffix("/metrics")
        ):
            console.print("who reaches that port reads them: HTTP has neither keys nor encryption")
        yield MetricsSidecar(sidecar)
