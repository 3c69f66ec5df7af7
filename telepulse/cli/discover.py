"""`telepulse discover`: list the sensing nodes that are announced on the local network."""

import time
from typing import Annotated

import typer

from protocol.cli_options import one_line_errors, plain_console
from protocol.host.output import check_writable
from protocol.sockets import tcp_address
from telepulse.cli.options import PROGRAM, TablesOption
from telepulse.document import Chapter, Report, Table, write_json

COLUMNS = ("name", "stream", "address", "key", "node")


def discover(
    seconds: Annotated[float, typer.Option(min=0.1, max=3600, help="How long to search.")] = 4.0,
    json: TablesOption = None,
) -> None:
    """List the sensing nodes that announce themselves on the local network.

    A display connects to one by display-node --discover --named NAME. A node keeps the id after
    "node" when it is started again; its key is shown as a fingerprint. Announcements are not
    authenticated: only its key proves which node it is (display-node --peer).
    """
    console = plain_console(json=json)
    with one_line_errors(PROGRAM):
        check_writable(json)
        # Imported here: it needs a library that other commands do without.
        from protocol.discovery.browser import Browser

        with Browser() as look:
            time.sleep(seconds)
            found, refused = sorted(look.found, key=lambda one: one.name), look.refused
        rows = []
        for one in found:
            addresses = " ".join(tcp_address((address, one.port)) for address in one.addresses)
            key = one.fingerprint or "none: any display may connect"
            rows.append((one.name, one.stream, addresses, key, one.node))
            console.print(
                f"{one.name!r} at {addresses}: stream {one.stream!r}, key {key}, node {one.node}"
            )
        causes = ", ".join(f"{count} {cause}" for cause, count in sorted(refused.items()))
        title = f"{len(found)} sensing nodes announced; refused: {causes or 'nothing'}"
        console.print(title)
        if json is not None:
            chapter = Chapter("found", tables=(Table(title, COLUMNS, tuple(rows)),))
            write_json(Report("sensing nodes", (chapter,)), json)
