import math
from typing import Any

import numpy as np
import pytest

from protocol.config.scene import validate
from protocol.errors import SceneError
from pulse_sensors.force_scale import SensorTable


def newtons(value: float, **keys: Any) -> float:
    table = validate({"rate": "1 kHz"} | keys, SensorTable, "scene")
    return float(table.newtons(np.array([[value]]))[0, 0])


@pytest.mark.parametrize(
    ("value", "keys", "force_n"),
    [
        (0.3, {"unit": "N"}, 0.3),
        (300, {"unit": "mN", "preload": "0.2 N"}, 0.5),
        (0.022, {"unit": "V"}, 0.5),
        (27, {"unit": "mV", "offset": "5 mV"}, 0.5),
        (50, {"unit": "mV", "sensitivity": "100 mV/N"}, 0.5),
        (0.3 / (2 * math.pi * 9e-3), {"unit": "V", "film_radius": "9 mm"}, 1.0),
        (512 + 250, {"unit": "counts", "newtons_per_count": 0.002, "zero": 512}, 0.5),
        (100, {"unit": "counts", "newtons_per_count": -0.01, "zero": 200}, 1.0),
    ],
)
def test_a_unit_becomes_newtons(value: float, keys: dict[str, Any], force_n: float) -> None:
    assert newtons(value, **keys) == pytest.approx(force_n)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"unit": "counts"}, 'unit "counts" needs newtons_per_count'),
        ({"unit": "counts", "newtons_per_count": 0}, "which is not 0"),
        ({"unit": "N", "newtons_per_count": 1}, 'newtons_per_count is for unit counts, not "N"'),
        ({"unit": "counts", "newtons_per_count": 1, "offset": "1 V"}, "offset is for unit V or mV"),
        ({"unit": "V", "sensitivity": "1 V/N", "film_radius": "9 mm"}, "give one of them"),
    ],
)
def test_an_impossible_scale_is_refused_in_one_line(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=r"^scene") as caught:
        newtons(1, **keys)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
