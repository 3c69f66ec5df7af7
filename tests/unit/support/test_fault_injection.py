"""An injected fault that neither the finger nor a report would show if it were not injected."""

from tests.support.fault_injection import FaultInjector, FaultKind, InjectedFault


def test_answers_come_twice() -> None:
    injector = FaultInjector(step_m=1e-6)
    injector.begin(InjectedFault(FaultKind.DUPLICATED, 1.0), 0)
    injector.queue_answer(b"answer", 0)
    assert injector.due_answers(0) == [b"answer", b"answer"]
