"""`telepulse lsl`."""

from protocol.cli_options import (
    InsecureOption,
    KeyOption,
    LogLevelOption,
    PeerOption,
    QuietOption,
    StopAfterOption,
    one_line_errors,
    telemetry_keys,
)
from protocol.host.output import configure_logging
from protocol.host.process import stop_on_signals
from telepulse.cli.options import NOT_WHOLE, PROGRAM, AddressArgument, SilenceOption


def lsl(
    address: AddressArgument,
    seconds: StopAfterOption = None,
    until_silent: SilenceOption = None,
    quiet: QuietOption = False,
    log_level: LogLevelOption = None,
    key: KeyOption = None,
    peer: PeerOption = None,
    insecure: InsecureOption = False,
) -> None:
    """Publish a display's stream to the Lab Streaming Layer, where LabRecorder finds it.

    Three streams: "telepulse wrist", the force of each channel as it came; "telepulse finger",
    target and felt force of each tick; "telepulse events", events as markers. Ends with the
    display. With --key alone, the key is the display's own.

    Exit status: 0, 1 when telemetry was missed, which it prints, 2 when it cannot begin.
    """
    from telepulse.lsl_outlet import LslOutlet

    with one_line_errors(PROGRAM):
        configure_logging(log_level, quiet)
        keys = telemetry_keys(address, key, peer, insecure)
        outlet = LslOutlet(address, keys)
    stop_on_signals(outlet.stop)
    if not outlet.run(seconds, until_silent):
        raise SystemExit(NOT_WHOLE)
