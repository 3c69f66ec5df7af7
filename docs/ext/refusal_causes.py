"""Tables of the causes for which messages, samples and connections are refused."""

from collections.abc import Iterable

from protocol.refusals import CAUSE_MEANINGS, CONNECTIONS


def write() -> str:
    """Return a table of the causes of refused messages and samples, and one of connections."""
    return "\n".join(
        [
            *_table("message or sample", CAUSE_MEANINGS.keys() - CONNECTIONS.keys()),
            "",
            *_table("connection", CONNECTIONS),
        ]
    )


def _table(what: str, causes: Iterable[str]) -> list[str]:
    chosen = set(causes)
    return [
        f"| cause of a refused {what} | meaning |",
        "|---|---|",
        *(
            f"| `{name}` | {meaning} |"
            for name, meaning in CAUSE_MEANINGS.items()
            if name in chosen
        ),
    ]
