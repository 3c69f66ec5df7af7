from pathlib import Path

import numpy as np
import pytest

from sensing_node.files.signal_choice import choose_announcing, choose_pulse
from sensing_node.files.signals import SignalFile, SignalInfo


@pytest.mark.parametrize(
    ("names", "chosen", "announcing"),
    [
        ([("II", "mV"), ("ABP", "mmHg"), ("RESP", "V")], "ABP", "II"),
        ([("MCL1", "mV"), ("RESP", "V"), ("ART", "mmHg")], "ART", "MCL1"),
        ([("II", "mV"), ("Pleth", "NU")], "Pleth", "II"),
        ([("Pulse rate", "1/min"), ("Force felt", "mN")], "Force felt", None),
        ([("time", "s"), ("x", "N")], "x", None),
        ([("ECG lead II", "mV"), ("CVP", "mmHg")], "CVP", "ECG lead II"),
        ([("heart", ""), ("other", "")], "heart", None),
        ([("MLII", "mV"), ("V5", "mV")], "MLII", "V5"),
    ],
)
def test_the_pulse_is_chosen_by_name_then_unit_then_place(
    names: list[tuple[str, str]], chosen: str, announcing: str | None
) -> None:
    signals = tuple(SignalInfo(n, *each, 250.0) for n, each in enumerate(names))
    file = SignalFile(Path("x"), signals, lambda number: np.array([2.0, 1, 2]))
    pulse = choose_pulse(file).signal
    found = choose_announcing(file, pulse)
    assert (pulse.name, found and found.name) == (chosen, announcing)
