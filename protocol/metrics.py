"""The option for metrics, which a process beside the node serves."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from protocol.host.child_process import Sidecar, sidecar_module, start_sidecar
from protocol.sockets import beyond_loopback

logger = logging.getLogger(__name__)

MetricsOption = Annotated[
    str | None,
    typer.Option(
        metavar="[ADDRESS:]PORT",
        help="Serve this node's figures to Prometheus over HTTP, on this machine alone unless an"
        " address is given; port 0 picks a free one.",
    ),
]


class MetricsSidecar:
    """The process that serves a node's figures, if metrics are wanted."""

    def __init__(self, sidecar: Sidecar | None) -> None:
        """None: nothing is served."""
        self._sidecar = sidecar

    def __bool__(self) -> bool:
        return self._sidecar is not None

    def follow(self, telemetry_address: str, key: Path | None = None) -> None:
        """Serve the telemetry of an address; key: the node's own, where the telemetry needs one."""
        if self._sidecar is not None:
            own = None if key is None else str(key)
            self._sidecar.send(address=telemetry_address, key=own)


@contextmanager
def start_metrics(program: str, where: str | None) -> Iterator[MetricsSidecar]:
    """Serve metrics at `where` (None: not at all) within a `with`.

    Enter it before anything moves. Raises SidecarError where the port is taken, or the library or
    the package that serves them is missing.
    """
    if where is None:
        yield MetricsSidecar(None)
        return
    arguments = ("metrics server", sidecar_module("metrics"), program, where)
    with start_sidecar(*arguments) as sidecar:
        logger.info(f"metrics on {sidecar.ready_message}")
        if beyond_loopback(
            sidecar.ready_message.replace("http", "tcp", 1).removesuffix("/metrics")
        ):
            logger.warning(
                "all who can reach that port can read them: HTTP has neither keys nor encryption"
            )
        yield MetricsSidecar(sidecar)
