"""An example of each message, with its literal bytes, so that a test shows any change of them."""

import math

import numpy as np

from protocol.tactile import ElasticLayer
from protocol.wire import messages as wire
from protocol.wire.description import Channel, StreamDescription

DESCRIPTION = StreamDescription(
    name="radial pulse",
    period_ns=1_000_000,
    batch=5,
    channels=(Channel("force"),),
    layer=ElasticLayer(),
    group_delay_ns=3,
)

FLOAT32_FRAME = wire.Frame(
    session=7,
    first_sample=1000,
    t_first_ns=1_700_000_000_000_000_000,
    period_ns=1_000_000,
    values=np.array([[0.5], [-1.25]], "<f4"),
)
FLOAT32_BYTES = bytes.fromhex(
    "98 02 07 cd03e8 cf17979cfe362a0000 ce000f4240 01 04"
) + bytes.fromhex("c408 0000003f 0000a0bf")
FLOAT64_FRAME = wire.Frame(
    session=2**62,
    first_sample=0,
    t_first_ns=-1,
    period_ns=1,
    values=np.array([[1.0, -2.0]], "<f8"),
)
FLOAT64_BYTES = bytes.fromhex("98 02 cf4000000000000000 00 ff 01 02 08") + bytes.fromhex(
    "c410 000000000000f03f 00000000000000c0"
)

CONTROL: dict[str, tuple[wire.ControlMessage, bytes]] = {
    "hello": (wire.Hello("display-1"), b"\x93\x02\xa5hello\xa9display-1"),
    "welcome": (
        wire.Welcome(7, 250, DESCRIPTION),
        b"\x95\x02\xa7welcome\x07\xcc\xfa\x87"
        b"\xa4name\xacradial pulse"
        b"\xa9period_ns\xce\x00\x0f\x42\x40"
        b"\xa5batch\x05"
        b"\xa8channels\x91\x82\xa4name\xa5force\xa4unit\xa1N"
        b"\xa5layer\x84"
        b"\xb0young_modulus_pa\xcb\x41\x87\xd7\x84\x00\x00\x00\x00"
        b"\xabthickness_m\xcb\x3f\x60\x62\x4d\xd2\xf1\xa9\xfc"
        b"\xadpoisson_ratio\xcb\x3f\xe0\x00\x00\x00\x00\x00\x00"
        b"\xb0contact_length_m\xcb\x3f\xf0\x00\x00\x00\x00\x00\x00"
        b"\xb0bytes_per_sample\x04"
        b"\xaegroup_delay_ns\x03",
    ),
    "bye": (wire.Bye(7, 5000), b"\x94\x02\xa3bye\x07\xcd\x13\x88"),
    "clock request": (wire.ClockRequest(-5), b"\x93\x02\xa6clock?\xfb"),
    "clock reply": (wire.ClockReply(7, 1, 2, 3), b"\x96\x02\xa5clock\x07\x01\x02\x03"),
    "report": (
        wire.DisplayReport(7, "display-1", 90, 5, 6, 4, 1.5, math.nan, 40.0, 0.25),
        b"\x9c\x02\xa6report\x07\xa9display-1\x5a\x05\x06\x04"
        b"\xcb\x3f\xf8\x00\x00\x00\x00\x00\x00"
        b"\xcb\x7f\xf8\x00\x00\x00\x00\x00\x00"
        b"\xcb\x40\x44\x00\x00\x00\x00\x00\x00"
        b"\xcb\x3f\xd0\x00\x00\x00\x00\x00\x00",
    ),
    "set-point": (
        wire.SetPoint(7, 11, 3, -5, 400_000_000, 1.5),
        b"\x98\x02\xa9set_point\x07\x0b\x03\xfb\xce\x17\xd7\x84\x00"
        b"\xcb\x3f\xf8\x00\x00\x00\x00\x00\x00",
    ),
    "probe": (
        wire.ProbeReport(7, 11, 4, 2, 1, 9, "pressing", 1.5, -0.25),
        b"\x9b\x02\xa5probe\x07\x0b\x04\x02\x01\x09\xa8pressing"
        b"\xcb\x3f\xf8\x00\x00\x00\x00\x00\x00"
        b"\xcb\xbf\xd0\x00\x00\x00\x00\x00\x00",
    ),
}

HUGE = b"\xff\xff\xff\xff"
# Messages whose containers claim more than they hold.
FALSE_LENGTHS = {
    "an array of 2^32 - 1, empty": b"\xdd" + HUGE,
    "a map of 2^32 - 1, empty": b"\xdf" + HUGE,
    "bytes of 2^32 - 1, empty": b"\xc6" + HUGE,
    "a text of 2^32 - 1, empty": b"\xdb" + HUGE,
    "an extension of 2^32 - 1, empty": b"\xc9" + HUGE + b"\x05",
    "an array as long as the message": b"\xdc\xff\xf0" + bytes(wire.MAX_FRAME_BYTES - 100),
    "nested arrays without content": b"\xdc\xff\xf0" * 1000 + bytes(62_000),
    "nested maps without content": b"\xde\xff\xf0\xa0" * 1000 + bytes(61_000),
    "a status with such arrays": b"\x94\xa0\xa0\x81\xa0" + b"\xdc\xff\xf0" * 1000 + bytes(61_000),
    "nesting beyond msgpack's stack": b"\x91" * (wire.MAX_FRAME_BYTES - 1) + b"\x90",
}
