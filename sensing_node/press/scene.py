"""The `press` table of a sensing node: the limits of the probe at the wrist, and its drive."""

from pydantic import model_validator

from pulse_drives.scene import DriveTable, MotorScene
from pulse_sensors.sensor import OneForceSensor
from sensing_node.press.probe import CLEARANCE_M, ProbeLimits


class ProbeScene(ProbeLimits):
    """The `press` table: the probe follows a distant finger within these limits.

    force_limit and slew_limit: of the force on the wrist. overforce: measured force, as a multiple
    of the limit, that is a fault. max_speed and travel: of the drive. resting: force to which the
    probe eases off without set-points for stale_after; after leave_after it leaves the wrist.
    cell_within: time without a reading of the load cell that is a fault.

    drive and motor: of a real probe. Its `touch` leads from home to the place where the probe rests
    off the wrist; `travel` begins there. sensor: the load cell, where it is not a channel of the
    source.
    """

    drive: DriveTable | None = None
    motor: MotorScene = MotorScene()
    sensor: OneForceSensor | None = None

    @model_validator(mode="after")
    def _has_limits_in_order(self) -> "ProbeScene":
        if self.resting_n > self.force_limit_n:
            raise ValueError("resting must be at most force_limit")
        if self.stale_after_ns > self.leave_after_ns:
            raise ValueError("stale_after must be at most leave_after")
        drive, motor = self.drive, self.motor
        if drive is None:
            return self
        if self.max_speed_m_per_s > motor.max_speed_m_per_s:
            raise ValueError("max_speed is more than motor.max_speed")
        if drive.touch_m + self.travel_m > motor.stroke_m:
            raise ValueError("drive.touch and travel together are more than motor.stroke")
        if drive.furthest_m is not None and drive.furthest_m <= CLEARANCE_M:
            raise ValueError("drive.furthest ends before the wrist; leave it out for travel")
        return self
