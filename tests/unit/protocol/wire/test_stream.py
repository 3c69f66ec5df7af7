import math
from dataclasses import replace
from typing import Any

import pytest
from pydantic import ValidationError

from protocol.config.scene import validate
from protocol.errors import SceneError, WireError
from protocol.tactile import ElasticLayer
from protocol.wire.stream import LayerTable, description_from_wire
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


@pytest.mark.parametrize(("period_ns", "rate_hz"), [(1_000_000, 1000), (1_000, 1e6), (10**10, 0.1)])
def test_the_rate_is_the_periods_inverse(period_ns: int, rate_hz: float) -> None:
    assert description_from_wire(WIRE | {"period_ns": period_ns}).rate_hz == rate_hz


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"name": ""}, "name"),
        ({"name": "x" * 81}, "name"),
        ({"name": "\x1b[31mred"}, "name"),
        ({"name": b"pulse"}, "name"),
        ({"name": None}, "name"),
        ({"period_ns": 999}, "period_ns"),
        ({"period_ns": 10_000_000_001}, "period_ns"),
        ({"period_ns": -1_000_000}, "period_ns"),
        ({"period_ns": 2**64 - 1}, "period_ns"),
        ({"period_ns": 1e6}, "period_ns"),
        ({"period_ns": "1000000"}, "period_ns"),
        ({"batch": 0}, "batch"),
        ({"batch": 4097}, "batch"),
        ({"batch": True}, "batch"),
        ({"channels": []}, "channels"),
        ({"channels": [{"name": "x"}] * 65}, "channels"),
        ({"channels": [{}]}, "channels.0.name"),
        ({"channels": [{"name": "x"}, {"name": ""}]}, "channels.1.name"),
        ({"channels": [{"name": "x", "unit": "mN"}]}, "channels.0.unit"),
        ({"channels": [{"name": "x", "gain": 1}]}, "channels.0.gain"),
        ({"channels": "force"}, "channels"),
        ({"channels": [{"name": "cun"}, {"name": "chi"}, {"name": "cun"}]}, "channels"),
        ({"layer": None}, "layer"),
        ({"layer": LAYER | {"thickness_m": 0.0}}, "layer"),
        ({"layer": LAYER | {"thickness_m": -2e-3}}, "layer"),
        ({"layer": LAYER | {"thickness_m": math.nan}}, "layer.thickness_m"),
        ({"layer": LAYER | {"young_modulus_pa": math.inf}}, "layer.young_modulus_pa"),
        ({"layer": LAYER | {"poisson_ratio": 0.6}}, "layer"),
        ({"layer": LAYER | {"colour": "red"}}, "layer.colour"),
        ({"layer": LAYER | {"young_modulus_pa": 1e-300, "thickness_m": 1e-300}}, "layer"),
        ({"bytes_per_sample": 2}, "bytes_per_sample"),
        ({"bytes_per_sample": True}, "bytes_per_sample"),
        ({"group_delay_ns": -1}, "group_delay_ns"),
        ({"group_delay_ns": True}, "group_delay_ns"),
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


@pytest.mark.parametrize("table", [None, 5, "pulse", [], [1], True, b"x"], ids=repr)
def test_a_description_must_be_a_table(table: object) -> None:
    with pytest.raises(WireError) as caught:
        description_from_wire(table)
    assert caught.value.cause == "description"


def test_a_node_cannot_describe_what_its_displays_would_refuse() -> None:
    with pytest.raises(ValidationError, match="batch"):
        replace(DESCRIPTION, batch=0)


def test_the_layer_of_a_scene_has_the_papers_values_by_default() -> None:
    table = validate({"young_modulus": "1 MPa", "thickness": "1 mm"}, LayerTable, "[layer]")
    assert table.layer() == ElasticLayer(1e6, 1e-3, 0.5, 1.0)
    assert LayerTable().layer() == ElasticLayer()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("young_modulus", "0 Pa"),
        ("thickness", "2 N"),
        ("poisson_ratio", 0.6),
        ("poisson_ratio", float("nan")),
        ("contact_length", "-1 m"),
    ],
)
def test_an_impossible_layer_of_a_scene_is_refused(key: str, value: object) -> None:
    with pytest.raises(SceneError, match=key):
        validate({key: value}, LayerTable, "[layer]")
