"""`telepulse view`: show a display live in a browser."""

import ipaddress
import logging
import sys
from contextlib import ExitStack
from importlib.util import find_spec
from subprocess import PIPE
from typing import Annotated

import typer
from rich.console import Console

from protocol.cli_options import (
    InsecureOption,
    KeyOption,
    LogLevelOption,
    PeerOption,
    QuietOption,
    StopAfterOption,
    one_line_errors,
    plain_console,
)
from protocol.errors import AddressError, OutputError, ProtectionError, TelepulseError
from protocol.host.child_process import ChildProcess
from protocol.host.output import configure_logging
from protocol.host.process import lower_priority, stop_on_signals
from protocol.security.link_keys import KeyOptions
from telepulse.cli.options import PROGRAM, AddressArgument

logger = logging.getLogger(__name__)

STARTS_WITHIN_S = 30.0


def check_bokeh() -> None:
    """Raise OutputError where the extra that draws the page is missing."""
    if find_spec("bokeh") is None:
        raise OutputError("Bokeh is missing; pip install 'telepulse[view]'")


def view(
    address: AddressArgument,
    port: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=65_535,
            help="Port of the page; default: 5006, or a free one if that is taken.",
        ),
    ] = None,
    host: Annotated[
        str,
        typer.Option(help="IP address to serve the page on; one beyond loopback needs --insecure."),
    ] = "127.0.0.1",
    seconds: StopAfterOption = None,
    quiet: QuietOption = False,
    log_level: LogLevelOption = None,
    key: KeyOption = None,
    peer: PeerOption = None,
    insecure: InsecureOption = False,
) -> None:
    """Show a display live in a browser: forces, errors, delays, clocks, alarms.

    A process of its own reads the display's telemetry, as a recorder does, and does not disturb
    the display's loop. The first line is the page's address. The display may start later, end
    and start again.

    Give the display's own key as --key; with another key, give --peer as well.

    Exit status: 0 when stopped, 2 when it cannot begin; the reason is one line on stderr.
    """
    console = plain_console(quiet)
    with one_line_errors(PROGRAM):
        configure_logging(log_level, quiet)
        check_bokeh()
        # Beyond loopback, --insecure is about the page; its link may have keys all the same.
        for_the_page = _beyond_this_machine(host, insecure) and key is not None
        options = KeyOptions(key, peer, insecure=insecure and not for_the_page)
        keys = options.telemetry_client(address)
        # The first import takes a second, during which an open page would not be updated.
        import scipy.signal  # noqa: F401

        from telepulse.view.server import PageServer

        # Before the server starts threads, which inherit it.
        lower_priority()
        page = PageServer(address, host, port, keys)
    stop_on_signals(page.stop)
    console.print(f"page: {page.url}")
    sys.stdout.flush()
    page.run(seconds)


def open_page(
    stack: ExitStack, telemetry: str, required: bool, console: Console
) -> ChildProcess | None:
    """Serve the live page until `stack` closes, and print its address; None where that fails.

    With `required`, raise OutputError or ProcessError instead.
    """
    try:
        check_bokeh()
        page = ChildProcess(
            *("live page", "-m", "telepulse", "view", telemetry), stdout=PIPE, stderr=PIPE
        )
        stack.callback(page.stop)
        console.print(page.read_line(STARTS_WITHIN_S))
    except TelepulseError as error:
        if required:
            raise
        logger.warning(f"no live page: {error}")
        return None
    return page


def _beyond_this_machine(host: str, insecure: bool) -> bool:
    """Return whether a page at `host` is open to other machines, which `insecure` permits.

    Raises AddressError for an invalid address, ProtectionError without the permission.
    """
    try:
        address = ipaddress.ip_address("127.0.0.1" if host == "localhost" else host)
    except ValueError:
        raise AddressError(f"--host {host}: give an IP address of this machine") from None
    if not (address.is_loopback or insecure):
        raise ProtectionError(
            f"--host {host} shows the page to all who reach this machine; --insecure allows it"
        )
    return not address.is_loopback
