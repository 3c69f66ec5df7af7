"""Lines of text from a sensor board; the first byte chooses how they are read and cut."""

from fuzz.packets import check_decoder
from pulse_sensors.text_lines import TextDecoder, TimeUnit

PERIOD_NS = 1_000_000
UNITS: tuple[TimeUnit | None, ...] = (None, "us", "ms", "s")


def seeds() -> list[bytes]:
    """Return lines with and without a time, and in the format of plotters."""
    untimed = b"\n0.25\n0.5\r\nforce:1e-3;2\nF: 0.3 N\nIR=5 RED=6\nS512\n0.3V, 31 C\n"
    timed = b"\n1000,0.5\n2000 0.25\n3000\t1\n9000;1\n10000,1\n"
    return [bytes([0]) + untimed, *(bytes([unit, 7]) + timed for unit in (1, 2, 3, 5))]


def try_one(data: bytes) -> None:
    """Decode any bytes, in pieces of any size."""
    if data:
        how = data[0]
        decoder = TextDecoder(PERIOD_NS, (how >> 2 & 3,), UNITS[how & 3])
        check_decoder(decoder, data[1:], 1 + (how >> 4) * 7)
