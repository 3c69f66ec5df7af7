"""What an operating system can do for a loop that has to be on time."""

from protocol.realtime.asked import Asked, parse_realtime
from protocol.realtime.held import Held, Refusal, check_strict, hold

__all__ = ["Asked", "Held", "Refusal", "check_strict", "hold", "parse_realtime"]
