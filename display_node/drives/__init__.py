"""Real drives of the actuator: TMCL modules and CiA 402 drives, behind one `Drive`."""

from display_node.drives.axis import build_axis
from display_node.drives.cia402.drive import Cia402Drive
from display_node.drives.drive import Drive
from display_node.drives.scene import Cia402Scene, TmclScene
from display_node.drives.tmcl.drive import TmclDrive
from display_node.plant.scene import SecondOrderScene, StepperScene
from protocol.errors import SceneError
from protocol.tactile import ElasticLayer

__all__ = ["Drive", "build_drive"]


def build_drive(
    scene: TmclScene | Cia402Scene,
    actuator: StepperScene | SecondOrderScene,
    layer: ElasticLayer,
    force_limit_n: float,
) -> Drive:
    """Build the drive that a scene names, without starting it. Raises SceneError."""
    if not isinstance(actuator, StepperScene):
        raise SceneError('[display] drive: it needs an actuator of kind "stepper"')
    axis = build_axis(scene, actuator, layer, force_limit_n)
    if isinstance(scene, Cia402Scene):
        return Cia402Drive(scene, axis)
    if actuator.microsteps.bit_count() != 1:
        raise SceneError(
            f"[display] actuator.microsteps: a TMCL module has 1, 2, 4, to 256,"
            f" got {actuator.microsteps}"
        )
    return TmclDrive(scene, axis)
