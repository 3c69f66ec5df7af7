"""Bases of a plug-in's kinds, and the types of what they build.

Each kind is a section model: a subclass of one of the bases below, with a `kind` of its own name. A
distribution names it in an entry point of the group. `telepulse.testing` checks it, and
`protocol.config.quantities` has the types of keys with units.
"""

from display_node.plant.scene import ACTUATORS, ActuatorScene, ForceModel, StepperScene
from display_node.prediction import Predictor
from display_node.prediction.scene import PREDICTORS, BasePredictor, PredictorScene
from protocol.config.kinds import KindGroup
from protocol.config.scene import Section
from protocol.errors import DriveError, SceneError, SourceError
from protocol.wire.description import Channel
from pulse_drives.axis import Axis
from pulse_drives.drive import Drive, DriveDevice
from pulse_drives.scene import DRIVES, DriveScene
from pulse_sensors.samples import DecodedBlock, decoded_block
from pulse_sensors.sensor import SENSORS, Decoder, Port, SensorScene
from sensing_node.sources.source import SOURCES, SampleSource, SourceContext, SourceScene

__all__ = [
    "ActuatorScene",
    "Axis",
    "BasePredictor",
    "Channel",
    "DecodedBlock",
    "Decoder",
    "Drive",
    "DriveDevice",
    "DriveError",
    "DriveScene",
    "ForceModel",
    "Port",
    "Predictor",
    "PredictorScene",
    "SampleSource",
    "SceneError",
    "Section",
    "SensorScene",
    "SourceContext",
    "SourceError",
    "SourceScene",
    "StepperScene",
    "decoded_block",
]
GROUPS: tuple[KindGroup, ...] = (SOURCES, SENSORS, DRIVES, ACTUATORS, PREDICTORS)
