"""Virtual time: how many questions are read of displays that ask without end."""

from sensing_node.control_server import (
    LEAST_PER_S,
    QUESTIONS_AT_ONCE,
    QUESTIONS_PER_S,
    QuestionBudget,
)

MS, SECONDS = 1_000_000, 10
# Each hold lets one more pass than the budget has.
HOLDS_PER_S = 200


def read_in(budget: QuestionBudget, waiting: int) -> int:
    """Read what waits, so many messages each millisecond for 10 s; return how many were read."""
    read = queued = 0
    for now_ns in range(0, SECONDS * 1_000 * MS, MS):
        queued += waiting
        while queued and not budget.held_for_ns(now_ns):
            read, queued = read + 1, queued - 1
            budget.spend(now_ns)
    return read


def test_of_a_flood_no_more_is_read_than_displays_send() -> None:
    budget = QuestionBudget()
    budget.expect(displays=2)
    most = QUESTIONS_AT_ONCE + SECONDS * (LEAST_PER_S + 2 * QUESTIONS_PER_S + HOLDS_PER_S)
    assert most / 2 < read_in(budget, waiting=75) <= most
    assert budget.held > 0


def test_of_a_hundred_displays_every_question_is_read() -> None:
    budget = QuestionBudget()
    budget.expect(displays=100)
    # Each asks 60 times a second.
    assert read_in(budget, waiting=6) == SECONDS * 6_000
    assert budget.held == 0


def test_a_clock_that_steps_back_holds_nothing() -> None:
    budget = QuestionBudget()
    later_ns = 3_600 * 1_000 * MS
    while budget.spend(later_ns):
        pass
    assert budget.held_for_ns(later_ns) > 0
    assert budget.held_for_ns(0) == 0
