"""Instructions, axis and global parameters of TMCL, as its firmware manuals number them."""

from enum import IntEnum, IntFlag

# Status of a reply to a request that was carried out.
SUCCESS = 100


class Command(IntEnum):
    """Instructions."""

    ROTATE_RIGHT = 1
    ROTATE_LEFT = 2
    MOTOR_STOP = 3
    SET_AXIS = 5
    GET_AXIS = 6
    SET_GLOBAL = 9
    GET_GLOBAL = 10
    REFERENCE_SEARCH = 13
    FIRMWARE_VERSION = 136


class Parameter(IntEnum):
    """Axis parameters."""

    ACTUAL_POSITION = 1
    ACTUAL_SPEED = 3
    MAX_SPEED = 4
    MAX_ACCELERATION = 5
    RIGHT_SWITCH_STATE = 10
    LEFT_SWITCH_STATE = 11
    MICROSTEPS = 140
    SEARCH_MODE = 193
    SEARCH_SPEED = 194
    SWITCH_SPEED = 195
    ERROR_FLAGS = 207
    DRIVER_FLAGS = 208


class Global(IntEnum):
    """Global parameters of bank 0: ms without a request after which the motor is stopped."""

    SERIAL_HEARTBEAT = 68
    CAN_HEARTBEAT = 82


class Search(IntEnum):
    """Types of the reference search's instruction."""

    START = 0
    STOP = 1
    STATUS = 2


# Reference search: the left switch alone; the right one instead of the left.
LEFT_SWITCH = 1
RIGHT_SWITCH = 65


class ErrorFlag(IntFlag):
    """Reason for which the module stopped the motor (axis parameter 207)."""

    STALL = 1
    DEVIATION = 2


class DriverFlag(IntFlag):
    """Errors of the driver chip (axis parameter 208) that stop the motor.

    The bits are those of a TMC26x.
    """

    OVERTEMPERATURE = 2
    SHORT_A = 8
    SHORT_B = 16


STOPPING = DriverFlag.OVERTEMPERATURE | DriverFlag.SHORT_A | DriverFlag.SHORT_B
