from pathlib import Path

import numpy as np
import pytest

from protocol.errors import SourceError
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
    ],
)
def test_of_signals_too_short_for_a_shape_names_and_units_decide(
    names: list[tuple[str, str]], chosen: str, announcing: str | None
) -> None:
    signals = tuple(SignalInfo(n, *each, 250.0) for n, each in enumerate(names))
    file = SignalFile(Path("x"), signals, lambda number: np.array([2.0, 1, 2]))
    pulse = choose_pulse(file).signal
    found = choose_announcing(file, pulse)
    assert (pulse.name, found and found.name) == (chosen, announcing)


@pytest.mark.parametrize("names", [("heart", "other"), ("MLII", "V5")])
def test_two_signals_of_one_rank_are_refused_by_name(names: tuple[str, str]) -> None:
    signals = tuple(SignalInfo(n, each, "mV", 250.0) for n, each in enumerate(names))
    file = SignalFile(Path("x"), signals, lambda number: np.array([2.0, 1, 2]))
    with pytest.raises(SourceError) as caught:
        choose_pulse(file)
    assert all(f"{name} too short" in str(caught.value) for name in names)
    assert "--channel" in str(caught.value)


def test_a_file_of_one_column_is_played_without_a_steady_pulse() -> None:
    noise = np.random.default_rng(1).normal(size=5000)
    file = SignalFile(Path("x"), (SignalInfo(0, "", "", 250.0),), lambda number: noise)
    assert choose_pulse(file).reason == "as the only signal, though it has no steady pulse"
    titled = SignalFile(Path("x"), file.signals, file.values, titles=("", "time"))
    with pytest.raises(SourceError, match="holds no pulse: column 0 no pulse"):
        choose_pulse(titled)
