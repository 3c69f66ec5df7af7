"""Composition of a status line: whole items by importance, the alerts last. Pure."""

from collections.abc import Sequence

from display_node.telemetry.alerts import Alert

# Half a wide terminal; a log or a journal shows it without wrapping.
LINE_WIDTH = 100


def compose(state: str, items: Sequence[str], alerts: Sequence[Alert]) -> str:
    """Return state, items and alerts in one line of at most `LINE_WIDTH` characters.

    Nothing is cut: an item that has no room is left out, the last ones first. Alerts come last,
    with their texts if there is room, else by their names, else as a number; each was printed in
    full when it began.
    """
    state = state if len(state) <= LINE_WIDTH // 2 else "unknown state"
    # An alert need not repeat the state.
    names = [alert.name.removeprefix(f"{state}: ") for alert in alerts]
    texts = [f"{name}: {alert.text}" for name, alert in zip(names, alerts, strict=True)]
    last = _first_that_fits(
        ["; ".join(names), f"{len(alerts)} alerts"], LINE_WIDTH - len(f"{state}: ")
    )
    shown: list[str] = []
    for item in items:
        if item and len(_line(state, [*shown, item], last)) <= LINE_WIDTH:
            shown.append(item)
    whole = _line(state, shown, "; ".join(texts))
    return whole if len(whole) <= LINE_WIDTH else _line(state, shown, last)


def _first_that_fits(texts: Sequence[str], width: int) -> str:
    return next((text for text in texts if len(text) <= width), "")


def _line(state: str, items: Sequence[str], last: str) -> str:
    told = "; ".join(text for text in (", ".join(items), last) if text)
    return f"{state}: {told}" if told else state
