"""The state machine of CiA 402: the statusword's states and the controlwords between them."""

from enum import Enum, IntEnum


class State(Enum):
    """State of the power drive system, with the statusword's mask and value."""

    NOT_READY = (0x4F, 0x00)
    SWITCH_ON_DISABLED = (0x4F, 0x40)
    READY = (0x6F, 0x21)
    SWITCHED_ON = (0x6F, 0x23)
    ENABLED = (0x6F, 0x27)
    QUICK_STOP = (0x6F, 0x07)
    REACTING = (0x4F, 0x0F)
    FAULT = (0x4F, 0x08)

    @property
    def text(self) -> str:
        """The state in words."""
        return self.name.lower().replace("_", " ")


class Controlword(IntEnum):
    """Controlword (0x6040)."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE = 0x0F
    START_HOMING = 0x1F
    RESET_FAULT = 0x80


class Mode(IntEnum):
    """Mode of operation (0x6060)."""

    PROFILE_VELOCITY = 3
    HOMING = 6
    CYCLIC_VELOCITY = 9

    @property
    def supported_bit(self) -> int:
        """Its bit in the supported drive modes (0x6502)."""
        return 1 << (self - 1)


# Bits of the statusword while homing.
HOMING_ATTAINED = 0x1400
HOMING_ERROR = 0x2000

# Homing methods (0x6098): negative limit switch, positive limit switch, present position.
NEGATIVE_SWITCH, POSITIVE_SWITCH, HERE = 17, 18, 35

HEARTBEAT_ERROR = 0x8130
# Error codes (0x603F).
ERRORS = {
    0: "no error code",
    0x4210: "overtemperature",
    0x4310: "overtemperature",
    0x7121: "motor blocked",
    HEARTBEAT_ERROR: "it missed our heartbeat",
    0x8611: "following error",
}

_NEXT = {
    State.SWITCH_ON_DISABLED: Controlword.SHUTDOWN,
    State.READY: Controlword.SWITCH_ON,
    State.SWITCHED_ON: Controlword.ENABLE,
    State.ENABLED: Controlword.ENABLE,
    State.FAULT: Controlword.RESET_FAULT,
}


def state_of(statusword: int) -> State | None:
    """Return a statusword's state; None where CiA 402 has no such state."""
    fitting = (state for state in State if statusword & state.value[0] == state.value[1])
    return next(fitting, None)


def towards_enabled(state: State, last: Controlword) -> Controlword:
    """Return the controlword for the transition towards operation enabled.

    last: the previous controlword. A fault is reset by the rising edge of a bit.
    """
    control = _NEXT.get(state, Controlword.DISABLE_VOLTAGE)
    if control == last == Controlword.RESET_FAULT:
        return Controlword.DISABLE_VOLTAGE
    return control
