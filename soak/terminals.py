"""Terminals of displays: the lines of `display_node.telemetry.terminal`, as they are read."""

import asyncio
import time
from contextlib import suppress
from dataclasses import dataclass, field

from protocol.host.child_process import python_command
from soak.claims import LineClaim, read_line
from soak.taps import end_tasks

# A stopped display ends its terminal; another is opened for the next display.
AGAIN_AFTER_S = 0.2


@dataclass(slots=True)
class Terminals:
    """Terminals of displays. lines: the lines shown, by the display's role."""

    lines: dict[str, list[LineClaim]] = field(default_factory=dict)
    _tasks: list[asyncio.Task[None]] = field(default_factory=list)

    def open(self, role: str, address: str) -> None:
        """Show a display's telemetry in a process, as `display-node` does itself.

        The process is started here and not by the display, so that it outlives a killed one.
        """
        self.lines[role] = []
        self._tasks.append(asyncio.create_task(self._show(role, address)))

    async def close(self) -> None:
        """End all terminals. Raises the errors of reading them."""
        await end_tasks(self._tasks)

    async def _show(self, role: str, address: str) -> None:
        while True:
            process = await asyncio.create_subprocess_exec(
                *python_command("-m", "display_node.telemetry.terminal", address),
                stdout=asyncio.subprocess.PIPE,
                start_new_session=True,
            )
            try:
                await self._read(process, role)
            except asyncio.CancelledError:
                with suppress(ProcessLookupError):
                    process.kill()
                raise
            finally:
                await process.wait()
            await asyncio.sleep(AGAIN_AFTER_S)

    async def _read(self, process: asyncio.subprocess.Process, role: str) -> None:
        assert process.stdout is not None
        async for data in process.stdout:
            claim = read_line(data.decode("utf-8", "replace").rstrip("\n"), time.perf_counter_ns())
            if claim is not None:
                self.lines[role].append(claim)
