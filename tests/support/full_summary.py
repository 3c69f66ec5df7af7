"""A summary in which every figure has a value, each another one."""

import dataclasses
from itertools import count
from typing import Any, get_type_hints

from protocol.faults import Fault, FaultKind, Note, Part
from protocol.finger import WithdrawalOutcome
from protocol.refusals import Reason
from protocol.summary.fields import ErrorWindow, Summary, read_summary


def full_summary() -> Summary:
    """Return a summary without a null, each number in it another."""
    values = _values(Summary, count(101))
    return read_summary(values)


def _values(kind: Any, numbers: "count[int]") -> Any:
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind)
        return {name: _values(hint, numbers) for name, hint in hints.items() if name != "beyond"}
    return {
        int | None: lambda: next(numbers),
        float: lambda: next(numbers) * 0.01,
        float | None: lambda: next(numbers) * 0.01,
        bool | None: lambda: True,
        str | None: lambda: f"text {next(numbers)}",
        list[str]: lambda: [f"word {next(numbers)}"],
        WithdrawalOutcome | None: lambda: WithdrawalOutcome.UNDER_WAY,
        list[ErrorWindow]: lambda: [_values(ErrorWindow, numbers)],
        list[Fault]: lambda: [
            Fault(FaultKind.SILENT, Part.FILM, f"cause {next(numbers)}", next(numbers), "cun")
        ],
        list[Note]: lambda: [Note(Part.SENSOR, f"note {next(numbers)}", "cun")],
        list[Reason]: lambda: [Reason(f"reason {next(numbers)}", f"remedy {next(numbers)}")],
        # Of an only contactor, whose figures are those at the top level.
        dict[str, Summary]: dict,
        dict[str, int]: lambda: {f"name {next(numbers)}": next(numbers)},
    }[kind]()
