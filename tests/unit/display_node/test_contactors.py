"""Several contactors of one display: one instant, one E, one safety."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from display_node.control.force_loop import ForceLoop
from display_node.display import Display
from display_node.prediction.ensemble import Ensemble
from display_node.scene import DisplayScene
from display_node.scoring.availability import InterruptionCounter
from display_node.scoring.beat_statistics import BeatStatistics
from display_node.scoring.prediction_score import PredictionScore
from display_node.scoring.tracking_error import TrackingError
from protocol.config.scene import validate
from protocol.errors import SceneError
from protocol.pieces import complete
from protocol.summary.fields import contactors_of
from protocol.wire.description import Channel
from protocol.wire.messages import Bye, Frame, encode_control, encode_frame
from tests.support.given_faults import FILM_LOST
from tests.support.refusals import refusal_of
from tests.support.sender import AHEAD_NS, MS, Sender, display_scene
from tests.support.streams import description

Channels = Callable[[int], list[float]]
NAMES = ("cun", "guan", "chi")
STREAM = description(channels=tuple(Channel(name) for name in NAMES))
PLAIN = {"controller": {"kp": 30, "error": "position", "feed_forward": True}}
SLOW = {**PLAIN, "actuator": {"kind": "stepper", "latency": "5 ms"}}
# A frame every 5 ms, which arrives after 20 ms.
ONE_WAY_MS = 20


def scene(*contactors: dict[str, object], **changes: object) -> DisplayScene:
    table: dict[str, object] = {
        "controller": {"kp": 390, "error": "position", "feed_forward": True, "dead_band": 3.2e-7},
        "actuator": {"kind": "stepper"},
        "predictor": "linear",
        "tick": "1 ms",
        "contactor": list(contactors) or [{"channel": name} for name in NAMES],
    }
    return validate(table | changes, DisplayScene, "[display]")


def pulse_n(sample: float) -> list[float]:
    """Return the force of each channel, each later than the one before by 3 samples."""
    return [0.3 + 0.1 * np.sin(2 * np.pi * 1.25e-3 * (sample - 3 * at)) for at in range(3)]


def play(
    under_test: Display,
    sender: Sender,
    from_ms: int,
    to_ms: int,
    channels: Channels = pulse_n,
    late_ms: Callable[[int], int] = lambda _: 0,
) -> tuple[list[int], list[list[float]]]:
    """Run a display on a pulse; return the instant and the target force of each contactor.

    channels: the values of a sample. late_ms: by how much the frame of a time comes later.
    """
    instants_ns, targets_n, waiting = [], [], list[tuple[int, bytes]]()
    for ms in range(from_ms, to_ms):
        while under_test.work():
            pass
        under_test.tick(ms * MS)
        sender.serve(under_test, ms * MS)
        if ms % 5 == 0 and ms >= ONE_WAY_MS:
            values = np.array([channels(sender.sent + number) for number in range(5)], "<f4")
            taken_ns = (ms - ONE_WAY_MS - 4) * MS + AHEAD_NS
            frame = Frame(sender.session, sender.sent, taken_ns, MS, values)
            sender.sent += 5
            waiting.append((ms + late_ms(ms), encode_frame(frame)))
        for due in [each for each in waiting if each[0] <= ms]:
            waiting.remove(due)
            under_test.on_frame(due[1], ms * MS)
        instants_ns.append(under_test.states[0].instant_ns)
        targets_n.append([state.target_n for state in under_test.states])
        assert len({state.instant_ns for state in under_test.states}) == 1
    return instants_ns, targets_n


def test_each_contactor_plays_its_channel_at_the_same_instant() -> None:
    under_test, sender = Display(scene(), "test"), Sender(stream=STREAM)
    instants_ns, targets_n = play(under_test, sender, 0, 3000)
    for now_ns, forces_n in zip(instants_ns[-1000:], targets_n[-1000:], strict=True):
        # The first sample is the one of 4 ms before 0.
        sample = (now_ns - AHEAD_NS) / MS + 4
        assert forces_n == pytest.approx(pulse_n(sample), abs=1e-3)
    assert under_test.state == "playing"


def test_contactors_are_in_the_summary_by_their_names_and_share_its_account() -> None:
    under_test, sender = Display(scene(), "test"), Sender(stream=STREAM)
    play(under_test, sender, 0, 3000)
    # It is built in pieces, of which each contactor adds one.
    assert sum(1 for _ in under_test.summary_pieces()) > len(NAMES)
    assert complete(under_test.summary_pieces()) == under_test.summary()
    summary = under_test.summary().to_dict()
    assert tuple(summary["contactors"]) == NAMES
    counts = summary["samples"]
    parts = ("played", "predicted", "late", "lost")
    assert counts["sent"] == sum(counts[part] for part in parts) > 2500
    for figures in contactors_of(summary).values():
        assert figures["beats"]["count"] > 0
        assert 0 < figures["force_rmse_n"]["aligned"] < 2e-3
    assert summary["force_rmse_n"]["aligned"] is None


def test_a_contactor_with_a_shorter_lead_plays_samples_that_are_late_for_another() -> None:
    quick, lazy = {"channel": "cun", **PLAIN}, {"channel": "chi", **SLOW}
    under_test, sender = Display(scene(quick, lazy), "test"), Sender(stream=STREAM)
    play(under_test, sender, 0, 1500)
    # Frames that the slow contactor needs up to 10 ms earlier than they come.
    play(under_test, sender, 1500, 3000, late_ms=lambda ms: ms // 5 % 3 * 5)
    summary = under_test.summary().to_dict()
    counts = {name: figures["samples"] for name, figures in summary["contactors"].items()}
    parts = ("played", "predicted", "late", "lost")
    for each in counts.values():
        assert each["sent"] == sum(each[part] for part in parts) == summary["samples"]["sent"]
    assert {part: counts["chi"][part] for part in parts} == {
        part: summary["samples"][part] for part in parts
    }
    assert counts["cun"]["played"] > counts["chi"]["played"]
    assert counts["cun"]["late"] < counts["chi"]["late"]


def test_an_only_contactor_has_its_figures_at_the_top_level() -> None:
    under_test = Display(scene({"channel": "guan"}), "test")
    play(under_test, Sender(stream=STREAM), 0, 3000)
    summary = under_test.summary().to_dict()
    assert summary["contactors"] == {}
    assert summary["force_rmse_n"]["aligned"] < 2e-3


def test_a_fault_of_one_contactor_brings_all_to_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    under_test, sender = Display(scene(), "test"), Sender(stream=STREAM)
    play(under_test, sender, 0, 2000)
    assert min(state.felt_n for state in under_test.states) > 0.15
    guan, read_film = under_test.contactors[1].loop, ForceLoop.read_film
    monkeypatch.setattr(
        ForceLoop, "read_film", lambda loop: 9.0 if loop is guan else read_film(loop)
    )
    play(under_test, sender, 2000, 2100)
    assert list(map(str, under_test.fade.faults)) == ["guan: film: felt force above 2.7 N"]
    assert under_test.state == "fault"
    assert all(state.target_n == 0.0 for state in under_test.states)
    assert max(state.felt_n for state in under_test.states) < 5e-3


def test_after_a_fault_nothing_counts_as_felt() -> None:
    under_test, sender = Display(scene(predictor="hold"), "test"), Sender(stream=STREAM)
    play(under_test, sender, 0, 2000)
    under_test.fade.fault(FILM_LOST)
    play(under_test, sender, 2000, 2200)
    before = under_test.summary()
    # From here on the samples come late, so that a prediction would have to stand in for them.
    play(under_test, sender, 2200, 5000, late_ms=lambda _: 40)
    under_test.finish_scores()
    after = under_test.summary()
    assert before.availability.seconds is not None
    assert after.availability.seconds is not None
    played_s = [
        (each.availability.played or 0.0) * (each.availability.seconds or 0.0)
        for each in (before, after)
    ]
    assert played_s == pytest.approx([played_s[0]] * 2)
    assert after.playout_delay_ms == before.playout_delay_ms
    for name in NAMES:
        old, new = (each.contactors[name].compensation for each in (before, after))
        assert (new.corrections, new.noticed_5s) == (old.corrections, old.noticed_5s)
    assert after.availability.felt is not None
    assert after.availability.faulted == pytest.approx(0.6, abs=0.02)


def second(value_n: Callable[[int], float]) -> Channels:
    """Return the channels of a peer of which the second is hostile, and the others are not."""
    return lambda sample: [pulse_n(sample)[0], value_n(sample), pulse_n(sample)[2]]


@pytest.mark.parametrize(
    ("channels", "refused", "state"),
    [
        (second(lambda _: math.nan), "not_finite", "stale"),
        (lambda sample: pulse_n(sample)[:2], "mismatch", "stale"),
        (second(lambda sample: 1e6 * (sample // 50 % 2)), None, "playing"),
        (second(lambda _: 0.0), None, "playing"),
    ],
    ids=["nan", "wrong count", "jumps", "no pulse"],
)
def test_a_hostile_second_channel_passes_no_limit_of_any_contactor(
    channels: Channels, refused: str | None, state: str
) -> None:
    under_test, sender = Display(scene(), "test"), Sender(stream=STREAM)
    play(under_test, sender, 0, 1500)
    limits = under_test.contactors[1].scene.safety
    _, targets_n = play(under_test, sender, 1500, 3000, channels)
    forces_n = np.array(targets_n)
    assert forces_n.max() <= limits.force_limit_n
    assert np.abs(np.diff(forces_n, axis=0)).max() <= limits.slew_limit_n_per_s * 1e-3 + 1e-9
    assert under_test.state == state
    assert under_test.fade.faults == []
    counts = under_test.receiver.account()
    assert counts.sent == counts.played + counts.predicted + counts.late + counts.lost
    if refused is None:
        # The other channels are played as they came.
        instant_ns = under_test.states[0].instant_ns
        genuine = pulse_n((instant_ns - AHEAD_NS) / MS + 4)
        assert forces_n[-1, [0, 2]] == pytest.approx([genuine[0], genuine[2]], abs=2e-3)
    else:
        # A frame is refused as a whole, and all contactors come to rest at once.
        assert under_test.receiver.rejected[refused] == 300
        assert not forces_n[-1].any()


@pytest.mark.parametrize(
    ("channels", "refused"),
    [
        (("cun", "chi"), "channel"),
        (("guan", "chi", "cun"), None),
        (("cun", "guan", "chi", "further"), None),
    ],
)
def test_a_description_that_changes_between_sessions_is_followed_by_name_or_refused(
    channels: tuple[str, ...], refused: str | None
) -> None:
    under_test, sender = Display(scene(), "test"), Sender(stream=STREAM)
    play(under_test, sender, 0, 1500)
    under_test.on_control(encode_control(Bye(sender.session, sender.sent)), 1500 * MS)
    changed = description(channels=tuple(Channel(name) for name in channels))
    other = Sender(session=9, stream=changed)

    def named(sample: int) -> list[float]:
        values_n = dict(zip(NAMES, pulse_n(sample), strict=True))
        return [values_n.get(name, 9.0) for name in channels]

    _, targets_n = play(under_test, other, 1500, 5000, named)
    assert under_test.fade.faults == []
    if refused is None:
        sample = (under_test.states[0].instant_ns - AHEAD_NS) / MS + 4 - 1500 + ONE_WAY_MS
        assert targets_n[-1] == pytest.approx(pulse_n(sample), abs=2e-3)
        assert under_test.state == "playing"
    else:
        assert under_test.receiver.rejected[refused] > 0
        assert targets_n[-1] == [0.0] * 3
        assert under_test.state != "playing"


def test_e_is_the_largest_that_a_contactor_requires() -> None:
    delays_ns = []
    for contactors in (
        [{"channel": "cun"}, {"channel": "chi"}],
        [{"channel": "cun"}, {"channel": "chi", **SLOW}],
    ):
        under_test = Display(scene(*contactors), "test")
        play(under_test, Sender(stream=STREAM), 0, 3000)
        delays_ns.append(under_test.states[0].playout_delay_ns)
    assert delays_ns[1] - delays_ns[0] == pytest.approx(5 * MS, abs=MS)


def test_each_contactor_inherits_the_displays_tables_and_changes_what_it_gives() -> None:
    found = scene(
        {"channel": "cun", "layer": {"thickness": "4 mm"}},
        {"channel": 2, "name": "third", "actuator": {"kind": "stepper", "lead": "1 mm"}},
        layer={"young_modulus": "0.1 GPa"},
    )
    first, third = found.contactors
    assert [first.shown_name, third.shown_name] == ["cun", "third"]
    assert first.layer.young_modulus_pa == third.layer.young_modulus_pa == 0.1e9
    assert (first.layer.thickness_m, third.layer.thickness_m) == (4e-3, 2e-3)
    assert first.actuator != third.actuator
    assert first.contactors == (first,)
    assert display_scene("radial").contactors == (display_scene("radial"),)


@pytest.mark.parametrize(
    ("contactors", "changes", "named"),
    [
        ([{"channel": "a"}, {"channel": "a"}], {}, "two contactors have the name 'a'"),
        ([{"channel": "a"}, {"channel": "hold-down"}], {}, 'channel "hold-down" holds the probe'),
        ([{"channel": "a"}], {"channel": "b"}, "belong to each"),
        ([{"chanel": "a"}], {}, "contactor.0.chanel: unknown key"),
        ([{"channel": 64}], {}, "contactor.0.channel"),
        ([{"channel": ""}], {}, "contactor.0.channel"),
        ([{"layer": {"thickness": "-1 mm"}}], {}, "contactor.0.layer.thickness"),
        ([{"predictor": "hold"}], {}, "contactor.0.predictor: unknown key"),
        ([{}] * 9, {}, "contactor"),
        (["cun"], {}, "contactor.0: must be a table"),
    ],
)
def test_a_contactor_that_cannot_be_used_is_one_line(
    contactors: list[dict[str, object]], changes: dict[str, object], named: str
) -> None:
    assert named in refusal_of(SceneError, scene, *contactors, **changes)


def test_every_actuator_is_commanded_before_anything_is_scored_or_learnt(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    order: list[str] = []

    def noted(name: str, owner: type, method: str) -> None:
        original = getattr(owner, method)

        def note(*arguments: object) -> object:
            order.append(name)
            return original(*arguments)

        monkeypatch.setattr(owner, method, note)

    noted("command", ForceLoop, "output")
    noted("move", ForceLoop, "move")
    noted("score", TrackingError, "add_output")
    noted("score", PredictionScore, "add_samples")
    noted("count", InterruptionCounter, "add")
    noted("learn", Ensemble, "work")
    noted("beats", BeatStatistics, "observe")
    under_test, sender = Display(scene(predictor="stack"), "test"), Sender(stream=STREAM)
    play(under_test, sender, 0, 3002)
    # Without slack for 0.1 s, a block of ticks waits, and many frames.
    with monkeypatch.context() as busy:
        busy.setattr(under_test, "work", lambda: False)
        play(under_test, sender, 3002, 3102)
    order.clear()
    under_test.command(3102 * MS)
    assert order == ["command"] * 3
    under_test.move()
    assert order[3:] == ["move"] * 3
    under_test.account()
    assert len(order) == 6
    while under_test.work():
        pass
    assert {"learn", "beats", "score", "count"} == set(order[6:])


def test_a_summary_has_all_ticks_and_frames_so_far_also_on_a_host_without_slack(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = []
    for slack in (True, False):
        under_test, sender = Display(scene(), "test"), Sender(stream=STREAM)
        if not slack:
            monkeypatch.setattr(under_test, "work", lambda: False)
        play(under_test, sender, 0, 5_077)
        partial = under_test.summary()
        assert partial.availability.seconds == pytest.approx(5.077)
        assert partial.playout_delay_ms.mean == pytest.approx(27)
        under_test.finish_scores()
        found.append((partial.availability.felt, partial.interruptions, under_test.summary()))
    assert found[0] == found[1]
