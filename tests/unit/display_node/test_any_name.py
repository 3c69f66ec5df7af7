"""A contactor may have any name: its faults, alerts and exit status do not depend on it."""

import io
import json
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from display_node.control.force_loop import ForceLoop
from display_node.display import Display
from display_node.scene import DisplayScene
from display_node.telemetry.alerts import AlertKind, alerts
from display_node.telemetry.terminal_view import TerminalView
from display_node.verdict import conclude
from protocol.cli_options import FAULT_STATUS
from protocol.config.scene import validate
from protocol.config.scene_file import find_scene
from protocol.faults import FaultKind, Part, faults_of
from protocol.provenance import collect
from protocol.summary.fields import read_summary
from protocol.wire.telemetry import STATUS, read_status
from telepulse.telemetry.events import EventDetector

MS = 1_000_000
UNLUCKY = ("sensing node", "film's sensor", "withdrawal: fault")
names = st.lists(
    st.sampled_from((*UNLUCKY, "fault", "drive", "film", "stale", "probe"))
    | st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S", "Zs")), min_size=1)
    .filter(lambda text: text == text.strip() and text.isprintable())
    .filter(lambda text: len(text) <= 20),
    min_size=3,
    max_size=3,
    unique=True,
)


def display(contactors: Sequence[str]) -> Display:
    tables = [{"name": name, "channel": number} for number, name in enumerate(contactors)]
    scene = {
        "controller": {"kp": 30, "error": "position", "feed_forward": True},
        "actuator": {"kind": "stepper"},
        "predictor": "linear",
        "contactor": tables,
    }
    return Display(validate(scene, DisplayScene, "[display]"), "test")


def with_wrong_film(under_test: Display, number: int) -> Display:
    """Tick while the film of one contactor reads more than any finger bears."""
    wrong, read_film = under_test.contactors[number].loop, ForceLoop.read_film
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            ForceLoop, "read_film", lambda loop: 9.0 if loop is wrong else read_film(loop)
        )
        for ms in range(3):
            under_test.tick(ms * MS)
    return under_test


@given(names, st.integers(0, 2))
@settings(max_examples=25)
def test_the_fault_of_a_contactor_is_known_by_its_kind_whatever_its_name(
    contactors: list[str], number: int
) -> None:
    under_test, name = with_wrong_film(display(contactors), number), contactors[number]
    status = read_status(under_test.pack_status(under_test.summary(), final=False))
    assert status.state == "fault"
    (fault,) = faults_of(status.summary)
    assert (fault.kind, fault.part, fault.contactor) == (FaultKind.OVERFORCE, Part.FILM, name)
    (alert,) = alerts(status.state, status.summary)
    assert (alert.kind, alert.fault) == (AlertKind.FAULT, fault)
    found = EventDetector().take(status.state, status.summary, 0)
    assert [event.level for event in found] == ["ERROR", "ERROR"]
    assert read_summary(json.loads(json.dumps(status.summary))).faults == [fault]
    view = TerminalView()
    view.take((STATUS, under_test.pack_status(under_test.summary(), final=False)))
    (text,) = view.new_alerts()
    assert text.startswith(f"fault: {name}: film: felt force above")


@pytest.mark.parametrize("number", range(3))
def test_a_display_with_unlucky_names_ends_with_the_status_of_a_fault(
    number: int, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = with_wrong_film(display(UNLUCKY), number).summary()
    out = Console(file=io.StringIO(), width=1_000)
    provenance = collect(find_scene("radial"), {})
    status = conclude("display-node", summary, "a run", out, None, provenance, details=False)
    assert status == FAULT_STATUS
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("display-node: ended at the fault ")
    assert UNLUCKY[number] in line
    assert line.endswith(summary.faults[0].remedy)


@pytest.mark.parametrize("name", UNLUCKY)
def test_a_contactor_with_an_unlucky_name_and_no_fault_has_none(name: str) -> None:
    under_test = display([name, "guan", "chi"])
    for ms in range(3):
        under_test.tick(ms * MS)
    summary = under_test.summary()
    assert (summary.faults, alerts(under_test.state, summary.to_dict())) == ([], [])
