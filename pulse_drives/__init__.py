"""Real drives of display and probe: TMCL modules and CiA 402 drives, behind one `Drive`."""

from protocol.errors import SceneError
from pulse_drives.axis import build_axis
from pulse_drives.cia402.drive import Cia402Drive
from pulse_drives.drive import Drive
from pulse_drives.scene import Cia402Scene, MotorScene, TmclScene
from pulse_drives.tmcl.drive import TmclDrive

__all__ = ["Drive", "build_drive"]


def build_drive(scene: TmclScene | Cia402Scene, motor: MotorScene, deepest_m: float) -> Drive:
    """Build the drive that a scene names, without starting it. Raises SceneError.

    deepest_m: furthest position beyond first touch that forces and the scene allow.
    """
    axis = build_axis(scene, motor, deepest_m)
    if isinstance(scene, Cia402Scene):
        return Cia402Drive(scene, axis)
    if motor.microsteps.bit_count() != 1:
        raise SceneError(
            f"actuator.microsteps: a TMCL module has 1, 2, 4, to 256, got {motor.microsteps}"
        )
    return TmclDrive(scene, axis)
