"""`telepulse discover`: list the sensing nodes that are announced on the local network."""

import time
from typing import Annotated

import typer

from protocol.cli_options import one_line_errors, plain_console
from protocol.discovery.announcement import Announcement
from protocol.host.output import check_writable
from telepulse.cli.options import PROGRAM, TablesOption
from telepulse.reports.document import Chapter, Report, Table, write_json

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
        causes = ", ".join(f"{count} {cause}" for cause, count in sorted(refused.items()))
        title = f"{len(found)} sensing nodes announced; refused: {causes or 'nothing'}"
        table = Table(title, COLUMNS, tuple(_row(one) for one in found))
        for name, stream, addresses, key, node in table.rows:
            console.print(f"{name!r} at {addresses}: stream {stream!r}, key {key}, node {node}")
        console.print(title)
        if json is not None:
            write_json(Report("sensing nodes", (Chapter("found", tables=(table,)),)), json)


def _row(one: Announcement) -> tuple[str, ...]:
    addresses = " ".join(f"tcp://{address}:{one.port}" for address in one.addresses)
    return (
        one.name,
        one.stream,
        addresses,
        one.fingerprint or "none: any display may connect",
        one.node,
    )
