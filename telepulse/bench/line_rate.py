"""How many commands a second a drive's line can carry, by its bits."""

from display_node.drives.scene import Cia402Scene, TmclScene
from telepulse.bench.verdict import Check

# A TMCL datagram has 9 bytes, each with a start and a stop bit; every request has its reply.
TMCL_BITS = 9 * 10
TMCL_CAN_BYTES = 7
# One cycle: RPDO (control word, target velocity), SYNC, TPDOs (status, mode and position; speed
# and error code).
CIA402_BYTES = (6, 0, 7, 6)


def can_frame_bits(data_bytes: int) -> int:
    """Bits of a CAN frame with an 11-bit identifier at worst: 47 of its own with the pause after
    it, its data, and a stuffed bit after every 4 of those that are stuffed (ISO 11898-1)."""
    return 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4


def exchange_s(scene: TmclScene | Cia402Scene) -> float:
    """How long one command and what answers it keep the line busy."""
    if isinstance(scene, Cia402Scene):
        return sum(map(can_frame_bits, CIA402_BYTES)) / scene.bitrate_bit_per_s
    if scene.port is None:
        return 2 * can_frame_bits(TMCL_CAN_BYTES) / scene.bitrate_bit_per_s
    return 2 * TMCL_BITS / scene.baud


def check_line(scene: TmclScene | Cia402Scene, tick_s: float) -> Check:
    """Whether the line can carry a command a tick, or at least one a `period`."""
    busy_s = exchange_s(scene)
    found = f"{busy_s * 1e3:.2f} ms each: at most {1 / busy_s:.0f} commands a second"
    if busy_s > scene.period_ns * 1e-9:
        period = f"{scene.period_ns * 1e-6:g} ms"
        reason = f"the drive's period is {period}: a faster line, or a longer period"
        return Check("line", found, "fail", reason)
    if busy_s > tick_s:
        reason = f"slower than the loop's {1 / tick_s:.0f} Hz: between them the newest command wins"
        return Check("line", found, "look", reason)
    return Check("line", found)
