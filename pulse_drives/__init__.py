"""Real drives of display and probe, behind one `Drive`.

- tmcl/: TMCL modules, `TmclDrive`.
- cia402/: CiA 402 drives on CANopen, `Cia402Drive`.
- stepdir/: telepulse's own board for a step and direction carrier, `StepdirDrive`.

A scene's `drive` table names its class in `DriveScene.driver`, by which `build_drive` loads it.
"""

from protocol.config.kinds import load_object
from pulse_drives.axis import build_axis
from pulse_drives.drive import Drive
from pulse_drives.scene import DriveScene, MotorScene

__all__ = ["Drive", "build_drive"]


def build_drive(scene: DriveScene, motor: MotorScene, deepest_m: float) -> Drive:
    """Build the drive that a scene names, without starting it. Raises SceneError.

    deepest_m: furthest position beyond first touch that forces and the scene allow.
    """
    drive: Drive = load_object(scene.driver)(scene, build_axis(scene, motor, deepest_m))
    return drive
