"""`telepulse link` and `relay`: forward a stream between nodes."""

import logging
from typing import Annotated

import typer

from protocol.cli_options import (
    AllowOption,
    InsecureOption,
    JsonOption,
    KeyOption,
    LogLevelOption,
    PeerOption,
    QuietOption,
    StopAfterOption,
    one_line_errors,
    plain_console,
    sum_up,
)
from protocol.host.output import check_writable, configure_logging
from protocol.host.process import freeze_objects, raise_file_limit, stop_on_signals
from protocol.provenance import collect
from protocol.security.link_keys import KeyOptions
from protocol.sockets import control_address
from telepulse.cli.options import PROGRAM, LinkOption, SeedOption
from telepulse.link_proxy import LinkProxy
from telepulse.relay import Relay
from telepulse.simulation.link_scene import LinkScene, parse_link

logger = logging.getLogger(__name__)


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
    """Forward a stream between two nodes over a worsened link.

    Delays and drops data frames on their way to the displays. Delays control messages both ways,
    and drops none of them.
    """
    with one_line_errors(PROGRAM):
        configure_logging(log_level)
        raise_file_limit()
        keys = KeyOptions(key, peer, allow, insecure)
        upstream, downstream = keys.forwarding_client(connect), keys.server(bind)
        model = parse_link(link) if link else LinkScene()
        proxy = LinkProxy(model, connect, bind, seed, upstream, downstream)
    stop_on_signals(proxy.stop)
    freeze_objects()
    proxy.run(seconds)


def relay(
    connect: Annotated[
        str,
        typer.Option(help="Address of the sensing node or of another relay; it may start later."),
    ],
    bind: Annotated[
        str,
        typer.Option(help="Address for displays to connect to; control uses the next port."),
    ],
    seconds: StopAfterOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    log_level: LogLevelOption = None,
    key: KeyOption = None,
    peer: PeerOption = None,
    allow: AllowOption = None,
    insecure: InsecureOption = False,
) -> None:
    r"""Forward one sensing node's stream to many displays.

    The sensing node sends each frame to a relay once, whatever the number of its displays.
    Displays connect to the relay as they would to the sensing node, and exchange clock requests and
    status with the sensing node itself. A stream may pass up to three relays; any number of relays
    may run side by side.

        telepulse relay --connect tcp://SENSING:5555 --bind "tcp://*:5655" \
            --key keys/relay.key --peer keys/wrist.pub

    The sensing node allows the relay's key, the relay those of its displays: each display that the
    relay allows receives the stream. A display gives the relay's public key as its --peer.

    Exit status: 0 at Ctrl-C or SIGTERM, 2 when an address or a key cannot be used; the reason is
    one line on stderr.
    """
    console = plain_console(quiet, json)
    with one_line_errors(PROGRAM):
        configure_logging(log_level, quiet)
        raise_file_limit()
        check_writable(json)
        control = control_address(bind)
        control_address(connect)
        keys = KeyOptions(key, peer, allow, insecure)
        upstream, downstream = keys.forwarding_client(connect), keys.server(bind)
        node = Relay(connect, bind, upstream, downstream)
        provenance = collect()
    stop_on_signals(node.stop)
    logger.info(f"relaying {connect} on {bind} (control {control})")
    freeze_objects()
    summary = node.run(seconds)
    sum_up(PROGRAM, summary, "relay", console, json, provenance)
