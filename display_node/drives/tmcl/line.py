"""The line of a TMCL module: requests, their replies, and the errors of both."""

import os
from collections import Counter
from typing import TYPE_CHECKING

from display_node.drives.can_bus import is_noise, open_bus
from display_node.drives.scene import TmclScene
from protocol.errors import DriveError

if TYPE_CHECKING:
    from display_node.drives.tmcl.interfaces import CanLine, SerialLine


class TmclLine:
    """One request at a time, each waiting for its reply; the codec is the maker's PyTrinamic.

    Attributes
    ----------
    counts
        Replies that were missing ("no answer"), "garbled" (a wrong checksum) or "wrong" (of another
        module or command), which are ignored.
    """

    def __init__(self, scene: TmclScene) -> None:
        """Open the line. Raises DriveError."""
        self._name = scene.port or f"{scene.interface} {scene.channel}"
        self._interface = _open(scene)
        self.counts: Counter[str] = Counter()

    def request(self, command: int, kind: int, motor: int, value: int = 0) -> int:
        """Send a request and return the signed value of its reply.

        Raises DriveError of kind "no answer", "garbled", "wrong" (only answers to something else
        came), "refused" or "unplugged".
        After one of the first three, what comes within another reply's time is discarded. A reply
        that is later still differs from the next one by its command alone.
        """
        import can
        from pytrinamic.tmcl import TMCLReplyChecksumError, TMCLReplyStatusError, TMCLStatus

        interface = self._interface
        stray = interface.stray
        try:
            reply = interface.send(command, kind, motor, value)
        except TimeoutError:
            if (wrong := interface.stray_reply) is None:
                return self._miss("no answer", f"no answer to command {command}")
            named = "an answer by {1} to {0}, about command {2}"
            text = named.format(wrong.reply_address, wrong.module_address, wrong.command)
            return self._miss("wrong", text)
        except TMCLReplyChecksumError:
            return self._miss("garbled", "an answer's checksum is wrong")
        except TMCLReplyStatusError as error:
            status = TMCLStatus.get_name(error.status_code).lower()
            text = f"{self._name}: command {command}, type {kind} is refused: {status}"
            raise DriveError("refused", text) from None
        except (OSError, can.CanError, ValueError, IndexError) as error:
            if is_noise(error):
                return self._miss("garbled", "an answer cannot be read")
            raise DriveError("unplugged", f"{self._name}: {error}") from None
        finally:
            if interface.stray > stray:
                self.counts["wrong"] += interface.stray - stray
        number: int = reply.value
        return number - (1 << 32) if number >= 1 << 31 else number

    def close(self) -> None:
        """Close the line."""
        self._interface.close()

    def _miss(self, kind: str, text: str) -> int:
        import can

        if kind != "wrong":  # each of those is counted already
            self.counts[kind] += 1
        try:
            self._interface.drain()
        except (OSError, can.CanError, ValueError, IndexError) as error:
            if not is_noise(error):
                raise DriveError("unplugged", f"{self._name}: {error}") from None
            self.counts["garbled"] += 1
        raise DriveError(kind, f"{self._name}: {text}")


def _open(scene: TmclScene) -> "SerialLine | CanLine":
    try:
        from display_node.drives.tmcl.interfaces import CanLine, SerialLine
    except ImportError as error:
        raise DriveError(
            "unplugged", f"PyTrinamic is missing ({error}); pip install 'telepulse[drives]'"
        ) from None
    import serial

    timeout_s = scene.reply_timeout_ns * 1e-9
    if scene.port is None:
        return CanLine(open_bus(scene), scene.host, scene.module, timeout_s)
    try:
        port = serial.serial_for_url(
            scene.port,
            scene.baud,
            timeout=timeout_s,
            write_timeout=scene.watchdog_ns * 1e-9,
            # Two programs that command one drive contradict each other.
            exclusive=True,
        )
    except (OSError, ValueError) as error:
        number = getattr(error, "errno", None)
        reason = os.strerror(number) if number else error
        raise DriveError("unplugged", f"{scene.port} cannot be opened: {reason}") from None
    return SerialLine(port, scene.host, scene.module)
