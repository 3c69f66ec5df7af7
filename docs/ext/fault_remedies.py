"""Table of each kind of fault, and its remedy."""

from protocol.faults import REMEDIES, START_AGAIN


def write() -> str:
    """Return a table of the kinds of faults and what to do."""
    rows = (
        f"| `{kind.value}` | {remedy.format(part='film or load cell')} |"
        for kind, remedy in REMEDIES.items()
    )
    again = f"{START_AGAIN[0].upper()}{START_AGAIN[1:]}."
    return "\n".join(["| kind of the fault | what to do |", "|---|---|", *rows, "", again])
