import math
from dataclasses import replace
from typing import Any

import pytest
from pydantic import ValidationError

from protocol.errors import WireError
from protocol.wire.description import description_from_wire
from tests.support.message_examples import DESCRIPTION

WIRE = DESCRIPTION.to_wire()
LAYER = WIRE["layer"]


def test_an_optional_field_has_a_default() -> None:
    needed = {key: WIRE[key] for key in ("name", "period_ns", "batch", "channels", "layer")}
    description = description_from_wire(needed)
    assert (description.bytes_per_sample, description.group_delay_ns) == (4, 0)
    for missing in needed:
        with pytest.raises(WireError, match=missing) as caught:
            description_from_wire({key: needed[key] for key in needed if key != missing})
        assert caught.value.cause == "description"


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"name": ""}, "name"),
        ({"name": "x" * 81}, "name"),
        ({"name": "\x1b[31mred"}, "name"),
        ({"period_ns": 999}, "period_ns"),
        ({"period_ns": 10_000_000_001}, "period_ns"),
        ({"period_ns": 2**64 - 1}, "period_ns"),
        ({"batch": 0}, "batch"),
        ({"batch": 4097}, "batch"),
        ({"batch": True}, "batch"),
        ({"channels": []}, "channels"),
        ({"channels": [{"name": "x"}] * 65}, "channels"),
        ({"channels": [{"name": "x"}, {"name": ""}]}, "channels.1.name"),
        ({"channels": [{"name": "x", "unit": "mN"}]}, "channels.0.unit"),
        ({"channels": [{"name": "cun"}, {"name": "chi"}, {"name": "cun"}]}, "channels"),
        ({"layer": LAYER | {"thickness_m": -2e-3}}, "layer"),
        ({"layer": LAYER | {"thickness_m": math.nan}}, "layer.thickness_m"),
        ({"bytes_per_sample": 2}, "bytes_per_sample"),
        ({"group_delay_ns": -1}, "group_delay_ns"),
        ({"group_delay_ns": 10_000_000_001}, "group_delay_ns"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_an_invalid_field_is_refused_by_its_place(change: dict[str, Any], place: str) -> None:
    with pytest.raises(WireError) as caught:
        description_from_wire(WIRE | change)
    assert caught.value.cause == "description"
    assert str(caught.value).startswith(f"stream description: {place}: ")


def test_a_channel_in_mv_or_of_that_name_announces() -> None:
    channels = [{"name": "cun"}, {"name": "II", "unit": "mV"}, {"name": "announce"}]
    described = description_from_wire(WIRE | {"channels": channels})
    assert [channel.announces for channel in described.channels] == [False, True, True]


def test_a_node_cannot_describe_what_its_displays_would_refuse() -> None:
    with pytest.raises(ValidationError, match="batch"):
        replace(DESCRIPTION, batch=0)
