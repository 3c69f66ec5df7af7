"""Reference of the summary's figures, from their registry."""

from typing import Any

from protocol.faults import Fault, Note
from protocol.finger import WithdrawalOutcome
from protocol.refusals import Reason
from protocol.summary.fields import OF_A_CONTACTOR, ErrorWindow, Summary
from protocol.summary.figures import Surface, figures

_KINDS = {
    int | None: "whole number",
    float | None: "number",
    bool | None: "true or false",
    str | None: "text",
    WithdrawalOutcome | None: "text",
    list[str]: "list of texts",
    list[Fault]: "list of maps: `kind` ([list](commands.md#faults)), `part`, `contactor`, `cause`,"
    " `at_ns`, `remedy`",
    list[Note]: "list of maps: `part`, `text`, `contactor`",
    list[Reason]: "list of maps: `text`, `further`",
    list[ErrorWindow]: "list of maps: `from_s`, `to_s`, `playout_delay_ms`, `aligned_n`,"
    " `in_phase_n`",
    dict[str, int]: "map of name to count",
    dict[str, Summary]: "map of name to the keys "
    + ", ".join(f"`{key}`" for key in OF_A_CONTACTOR),
}


def write() -> str:
    """Return the tables of all figures, and of those that an output omits."""
    rows = (
        f"| `{figure.key}` | {_kind(figure.type, figure.unit)} | {figure.meaning} |"
        f" {figure.row} | {_metric(figure)} |"
        for figure in figures()
    )
    return "\n".join(
        [
            "| key | value | meaning | row | metric |",
            "|---|---|---|---|---|",
            *rows,
            "",
            "## Figures that a surface leaves out",
            "",
            "| surface | figures | reason |",
            "|---|---|---|",
            *_left_out(),
        ]
    )


def _kind(kind: Any, unit: Any) -> str:
    return f"{_KINDS[kind]}, {unit.name}" if unit is not None and unit.name else _KINDS[kind]


def _metric(figure: Any) -> str:
    if Surface.METRICS in figure.absent:
        return ""
    names = [f'{name}="{value}"' for name, value in figure.labels.items()]
    labels = ",".join([*names, *([figure.label] if figure.label else []), *figure.keys])
    name = f"telepulse_{figure.metric}{'_total' if figure.counter else ''}"
    return f"`{name}{{{labels}}}`" if labels else f"`{name}`"


def _left_out() -> list[str]:
    keys: dict[tuple[str, str], list[str]] = {}
    for figure in figures():
        for surface, reason in figure.absent.items():
            keys.setdefault((surface.value, reason), []).append(f"`{figure.key}`")
    return [
        f"| {surface} | {', '.join(found)} | {reason} |"
        for (surface, reason), found in sorted(keys.items())
    ]
