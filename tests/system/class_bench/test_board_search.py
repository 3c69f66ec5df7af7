"""The finger's board under any commands, inputs and silences: no script breaks a rule.

`make fuzz ARGS=board` plays a hundred times as many. A firmware that is broken once, in each way
below, is found.
"""

from collections.abc import Callable
from pathlib import Path

import pytest

from telepulse.emulators import sketch
from tests.support.board_search import RULES, BoardSearch, Finding

pytestmark = pytest.mark.skipif(sketch.missing() is not None, reason=str(sketch.missing()))

SMOKE_MS = 500_000
# Ten million in all.
RANDOM_MS, SEEDS = 1_000_000, range(1, 11)
DEPTH, PARTS = 3, 4
# Some of the broken ones need rare inputs.
MOST_MS = 40_000_000
LONGEST_SHORTENED = 8
Change = tuple[str, str]


@pytest.fixture(scope="module")
def search(tmp_path_factory: pytest.TempPathFactory) -> BoardSearch:
    """Compile the sketch as it is."""
    return BoardSearch.compile(tmp_path_factory.mktemp("search"))


def nothing(finding: Finding | None) -> None:
    if finding is not None:
        pytest.fail(str(finding))


@pytest.mark.smoke
def test_a_few_scripts_break_no_rule(search: BoardSearch) -> None:
    for is_reversed in (False, True):
        passed_ms, sequences, finding = search.all_sequences(1, is_reversed)
        nothing(finding)
        assert passed_ms > 20_000
        assert sequences > 300
    passed_ms, finding = search.at_random(1, SMOKE_MS)
    nothing(finding)
    assert passed_ms >= SMOKE_MS


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("is_reversed", [False, True], ids=["right", "reversed"])
def test_no_short_sequence_in_any_state_breaks_a_rule(
    search: BoardSearch, is_reversed: bool, part: int
) -> None:
    passed_ms, sequences, finding = search.all_sequences(DEPTH, is_reversed, part, PARTS)
    nothing(finding)
    print(f"{sequences:,} sequences in {passed_ms:,} ms of the board")
    assert sequences > 50_000


@pytest.mark.parametrize("seed", SEEDS)
def test_no_random_script_breaks_a_rule(search: BoardSearch, seed: int) -> None:
    passed_ms, finding = search.at_random(seed, RANDOM_MS)
    nothing(finding)
    assert passed_ms >= RANDOM_MS


# Each of the defects of firmware 1.0, put back; then those that the search itself has found.
DEFECTS: dict[str, tuple[str, tuple[Change, ...]]] = {
    "home moves the limits": (
        "WRONG_TRANSITION",
        (
            (
                "if (state != ARMED) return WRONG_STATE;",
                "if (state != ARMED && state != READY && state != RUNNING) return WRONG_STATE;",
            ),
        ),
    ),
    "ready has no watchdog": (
        "STAYS_SILENT",
        (("} else if (watchdog.timed_out(", "} else if (state == RUNNING && watchdog.timed_out("),),
    ),
    "a withdrawal ends at lowest": (
        "CLAIMS_WITHDRAWN",
        (
            (
                "leave(min(stepper.position - (int32_t)limits.withdrawal, 0L), why);",
                "leave(max(stepper.position - (int32_t)limits.withdrawal, limits.lowest), why);",
            ),
        ),
    ),
    "a search goes back whatever the film shows": (
        "BACK_WITHOUT_RISE",
        (
            ("if (seeking && trend.fell()) {", "if (false) {"),
            ("} else if (!seeking || trend.rose()) {", "} else if (true) {"),
        ),
    ),
    "a switch that is stuck closed ends a withdrawal": (
        "CLAIMS_WITHDRAWN",
        (("home_closed && stepper.position <= 0;", "home_closed;"),),
    ),
    "disarm leaves the tip where it is": (
        "OFF_WHILE_OUT",
        (("else if (state == READY || state == RUNNING) leave(0, HOST);", ""),),
    ),
    "an armed board holds for ever": (
        "FORGOTTEN_ARMED",
        (("if (state == ARMED && present_ms", "if (false && present_ms"),),
    ),
    "steps of a program that hangs are forgotten": (
        "CLAIMS_WITHDRAWN",
        (("kept.position + (int16_t)(tick_steps - kept.steps)", "kept.position"),),
    ),
    "a torn position counts as home": (
        "CLAIMS_WITHDRAWN",
        (("? position : limits.highest);", "? position : 0);"),),
    ),
    "a reset after power-up withdraws": (
        "RESET_WITHOUT_WITHDRAWAL",
        (("    return;\n  }\n  forget_limits();\n", "    return;\n  }\n"),),
    ),
    "limits keep the old level of the switch": (
        "WRONG_HOME",
        (("  // By the new options.\n  take_switch();\n", ""),),
    ),
    "a switch that bounces is stale for 253 ms": (
        "STALE_INPUT",
        (("  home_closed = switch_is_closed();\n  home_changing = 0;\n",
          "  home_closed = switch_is_closed();\n"),),
    ),
}  # fmt: skip

# What each rule finds.
BROKEN: dict[str, tuple[str, tuple[Change, ...]]] = {
    "room up": (
        "BEYOND_HIGHEST",
        (("= inward ? highest - position :", "= inward ? highest - position + 5 :"),),
    ),
    "room down": ("BELOW_LOWEST", ((": position - lowest;", ": position - lowest + 3;"),)),
    "count": (
        "MISCOUNTED", (("tick_steps + (inward ? 1 : -1)", "tick_steps + (inward ? 1 : -2)"),)
    ),
    "rest": (
        "MOVES_AT_REST",
        (("if (stepper.wanted || stepper.velocity) return;", "if (stepper.wanted) return;"),),
    ),
    "ramp": (
        "TURNS_BACK",
        (("if (inward ? stepper.velocity < 0 : stepper.velocity > 0) stepper.halt();", ""),),
    ),
    "opening": (
        "SEARCHES_TOO_FAR",
        (("here + (int32_t)search.opening, max", "here + 2 * (int32_t)search.opening, max"),),
    ),
    "search": (
        "SEARCHES_TOO_FAR",
        (("position - (int32_t)search.distance,", "position - 2 * (int32_t)search.distance,"),),
    ),
    "clocks": (
        "TRIPS_WITHOUT_CAUSE",
        (("return now_ms - commanded_ms > after_ms;", "return now_ms > commanded_ms + after_ms;"),),
    ),
    "film": (
        "IGNORES_FILM",
        (("if (film_outside || (state == HOMING && trend.jumps(film))) {",
          "if (state == HOMING && (film_outside || trend.jumps(film))) {"),),
    ),
    "ready": (
        "MOVES_UNTOLD",
        (("  stepper.wanted = 0;\n  stepper.bound(limits.lowest",
          "  stepper.bound(limits.lowest"),),
    ),
    "validity": (
        "MOVES_UNTOLD", (("if (watchdog.expires(present_ms)) stepper", "if (false) stepper"),)
    ),
    "no switch": ("SEARCHES_TOO_LONG", (("end_search(NO_HOME);", ";"),)),
    "stuck": ("SEARCHES_TOO_LONG", (("end_search(STUCK_SWITCH);", ";"),)),
    "timeout": ("SEARCHES_TOO_LONG", (("end_search(HOMING_TIMEOUT);", "seeking = seeking;"),)),
    "outside": (
        "STALE_INPUT",
        (("film_outside = has_limits && (least", "film_outside = has_limits || (least"),),
    ),
    "early": (
        "TRIPS_WITHOUT_CAUSE",
        (("now_ms - commanded_ms > after_ms;", "now_ms - commanded_ms > after_ms / 2;"),),
    ),
    "cause": (
        "TRIPS_WITHOUT_CAUSE", (("withdraw(FAULT_PIN);", "withdraw(NO_HOME);"),)
    ),
    "jump": (
        "IGNORES_JUMP",
        (("if (film_outside || (state == HOMING && trend.jumps(film))) {", "if (film_outside) {"),),
    ),
    "fault pin": (
        "IGNORES_FAULT_PIN",
        (("} else if (faulty) {", "} else if (faulty && state == RUNNING) {"),),
    ),
    "switch": (
        "IGNORES_SWITCH",
        (("if (home_closed && stepper.position > (int32_t)search.opening)", "if (false)"),),
    ),
    "clear": (
        "WRONG_SEQUENCE",
        (("if (state != WITHDRAWN && state != FAULT) return WRONG_STATE;", ""),),
    ),
    "velocity": (
        "WRONG_TRANSITION",
        (("if (state < HOMING || state > RUNNING || valid", "if (state > RUNNING || valid"),),
    ),
    "bounds": ("WRONG_SEQUENCE", (("l.watchdog_ms > 500", "l.watchdog_ms > 5000"),)),
    "sequence": (
        "WRONG_SEQUENCE",
        (("if (result == DONE) sequence = number;", "sequence = number;"),),
    ),
    "answer": (
        "WRONG_ANSWER",
        (("if ((field = wrong_limit(wanted))) return OUT_OF_BOUNDS;",
          "if ((field = wrong_limit(wanted))) return UNKNOWN;"),),
    ),
    "no answer": (
        "NO_ANSWER",
        (("  writer.add(ANSWER);", "  if (result == NO_LIMITS) return;  writer.add(ANSWER);"),),
    ),
    "slow": (
        "LATE_WITHDRAWAL",
        (("rate = limits.withdrawal_rate;", "rate = limits.withdrawal_rate / 4;"),),
    ),
    "enable": ("MOTOR_PIN", (("  pin_enable(false);", "  pin_enable(next == FAULT);"),)),
    "away": (
        "AWAY_WITHOUT_FALL", (("if (seeking && trend.fell()) {", "if (seeking) {"),)
    ),
    "settling": ("BACK_WITHOUT_RISE", (("SETTLING_MS = 4,", "SETTLING_MS = 1,"),)),
    "pressing": ("SEARCH_PRESSES", (("if (trend.presses()) withdraw(PRESSED);", ";"),)),
    "second part": (
        "SEARCH_LEAVES_PRESSED",
        (("} else if (!seeking || trend.rose()) {", "} else if (trend.rose()) {"),),
    ),
    "rising": (
        "SEARCH_LEAVES_PRESSED",
        (("} else if (!seeking || trend.rose()) {", "} else if (!seeking) {"),),
    ),
    "kept limits": (
        "RESET_WITHOUT_WITHDRAWAL",
        (("  homed = true;\n  keep_limits();", "  homed = true;"),),
    ),
    "watchdog": (
        "HANGS", (("  board_alive();", "  if (state != WITHDRAWING) board_alive();"),)
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("rule", "changes"), [*DEFECTS.values(), *BROKEN.values()], ids=[*DEFECTS, *BROKEN]
)
def test_a_broken_firmware_is_found(rule: str, changes: tuple[Change, ...], tmp_path: Path) -> None:
    search = BoardSearch.compile(tmp_path, *changes)
    attempts: list[Callable[[], tuple[int, Finding | None]]] = [
        lambda: search.all_sequences(2, False)[::2],
        lambda: search.all_sequences(2, True)[::2],
    ]
    passed_ms, finding, seed = 0, None, 0
    while finding is None and passed_ms < MOST_MS:
        if attempts:
            more_ms, finding = attempts.pop(0)()
        else:
            seed += 1
            more_ms, finding = search.at_random(seed, RANDOM_MS)
        passed_ms += more_ms
    assert finding is not None
    assert finding.rule == rule, str(finding)
    assert len(finding.script) <= LONGEST_SHORTENED, str(finding)
    print(f"after {passed_ms:,} ms of the board: {finding}")


def test_each_rule_finds_a_broken_firmware() -> None:
    found = {rule for rule, _ in (*DEFECTS.values(), *BROKEN.values())}
    assert found == RULES


def test_a_finding_is_said_in_words(search: BoardSearch, tmp_path: Path) -> None:
    rule, changes = DEFECTS["ready has no watchdog"]
    _, _, finding = BoardSearch.compile(tmp_path, *changes).all_sequences(2, False)
    assert finding is not None
    head, setting, *script = str(finding).splitlines()
    assert head.startswith(f"{rule}: silence of")
    assert "start_mm 0.1" in setting
    assert [line.split()[1].rstrip(";") for line in script] == ["limits", "arm", "home"]
    assert "home rate=16000 distance=900 opening=100 timeout_ms=3000; 1 ms" in script[-1]
    # Played on the sketch as it is, the script breaks nothing.
    assert search.play(finding.setting, finding.script) is None
