"""`telepulse link`."""

import threading
from typing import Annotated

import typer

from protocol.cli_options import (
    AllowOption,
    InsecureOption,
    KeyOption,
    LogLevelOption,
    PeerOption,
    StopAfterOption,
    client_keys,
    one_line_errors,
    server_keys,
)
from protocol.host.output import configure_logging
from protocol.host.process import allow_connections, freeze_objects, stop_on_signals
from telepulse.cli.options import PROGRAM, LinkOption, SeedOption
from telepulse.netem.link_proxy import LinkProxy
from telepulse.simulation.link_model import LinkScene, parse_link


def link(
    connect: Annotated[str, typer.Option(help="Address of the sensing node.")],
    bind: Annotated[str, typer.Option(help="Address for displays to connect to.")],
    link: LinkOption = None,
    seconds: StopAfterOption = None,
    seed: SeedOption = 1,
    key: KeyOption = None,
    peer: PeerOption = None,
    allow: AllowOption = None,
    insecure: InsecureOption = False,
    log_level: LogLevelOption = None,
) -> None:
    """Pass a stream on between two nodes over a worse link.

    Delays, jitters and drops data frames on their way to the displays; control messages are
    delayed both ways and never dropped.
    """
    with one_line_errors(PROGRAM):
        configure_logging(log_level)
        allow_connections()
        # Without --peer the sensing node is on this machine, and has no keys.
        upstream = client_keys([connect], key if peer else None, peer, insecure)
        downstream = server_keys(bind, key, allow, insecure)
        model = parse_link(link) if link else LinkScene()
        proxy = LinkProxy(model, connect, bind, seed, upstream, downstream)
    stop_on_signals(proxy.stop)
    if seconds is not None:
        timer = threading.Timer(seconds, proxy.stop)
        timer.daemon = True
        timer.start()
    freeze_objects()
    proxy.run()
