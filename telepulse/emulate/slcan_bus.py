"""The CAN bus behind an emulated slcan adapter, on which an emulated node is the only one."""

import select
from collections import deque
from typing import Any

import can

from telepulse.emulate.pty_port import PtyPort
from telepulse.emulate.slcan_adapter import SlcanAdapter


class SlcanBus(can.BusABC):
    """A bus for a node: what the host sends through the adapter's serial port comes here."""

    def __init__(self, port: PtyPort) -> None:
        """The port is closed with the bus."""
        super().__init__(channel=str(port.path))
        self.channel_info = f"slcan {port.path}"
        self._port = port
        self._adapter = SlcanAdapter()
        self._waiting: deque[can.Message] = deque()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Tell the host of a frame; one that it does not fetch is dropped, as by an adapter."""
        self._port.write(self._adapter.encode(msg))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._waiting and select.select([self._port], [], [], timeout)[0]:
            answers, frames = self._adapter.feed(self._port.read())
            self._port.write(answers)
            self._waiting.extend(frames)
        return (self._waiting.popleft() if self._waiting else None), False

    def fileno(self) -> int:
        """For `select`."""
        return self._port.fileno()

    def shutdown(self) -> None:
        """Unplug the adapter."""
        if not self._is_shutdown:
            super().shutdown()
            self._port.close()

    def _apply_filters(self, filters: Any) -> None:
        """Frames are filtered as they are received."""
