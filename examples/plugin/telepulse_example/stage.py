"""A drive: a stage that moves at the commanded speed. This one is emulated by the host's clock."""

import time
from collections.abc import Callable
from typing import ClassVar, Literal

from telepulse.plugins import Axis, Drive, DriveDevice, DriveScene

STEP_S = 2e-3


class StageScene(DriveScene):
    """The `drive` table of kind "stage"; name: of the emulated stage."""

    driver: ClassVar[str] = "telepulse_example.stage:StageDrive"
    kind: Literal["stage"]
    name: str = "stage"


class Stage(DriveDevice):
    """An emulated stage. Its speed stays as commanded, as that of a real one may."""

    home_m = 0.0

    def __init__(self) -> None:
        self._from_m, self._from_s, self.speed_m_per_s = -1e-3, time.monotonic(), 0.0

    @property
    def position_m(self) -> float:  # type: ignore[override]
        """Position of the tip in m from first touch."""
        return self._from_m + self.speed_m_per_s * (time.monotonic() - self._from_s)

    def run(self, speed_m_per_s: float) -> None:
        """Move at a speed until the next one."""
        self._from_m, self._from_s = self.position_m, time.monotonic()
        self.speed_m_per_s = speed_m_per_s

    def configure(self) -> None:
        """See `DriveDevice.configure`."""

    def home(self, guard: Callable[[], None]) -> None:
        """Move to home, which the stage's scale shows, and leave it there."""
        guard()
        self._from_m, self._from_s, self.speed_m_per_s = self.home_m, time.monotonic(), 0.0

    def end_search(self) -> None:
        """See `DriveDevice.end_search`."""
        self.run(0.0)

    def arm_watchdog(self) -> None:
        """Do nothing: this stage has no watchdog, and the drive's thread watches the commands."""

    def close(self) -> None:
        """See `DriveDevice.close`."""
        self.run(0.0)


STAGES: dict[str, Stage] = {}


class StageDrive(Drive):
    """A `Drive` on an emulated stage."""

    step_s = STEP_S

    def __init__(self, scene: StageScene, axis: Axis) -> None:
        super().__init__(scene, axis)
        self._stage = STAGES.setdefault(scene.name, Stage())
        self._stage.home_m = axis.lowest_m

    def _connect(self) -> DriveDevice:
        return self._stage

    def _read_reports(self, now_ns: int) -> None:
        self._supervisor.check_silence(now_ns)
        self._supervisor.add_position(self._stage.position_m, now_ns)

    def _send(self, now_ns: int) -> None:
        """Send the speed that the supervisor allows: within the soft limits, or withdrawing."""
        velocity = self._supervisor.velocity_to_send(now_ns)
        self._stage.run(self._axis.units.speed_m_per_s(velocity))
        self._supervisor.mark_sent(velocity, now_ns)

    def _home_switch(self) -> bool | None:
        return None
