"""Table of each fault that a display latches, and its remedy."""

from display_node.fault_advice import ADVICE, OTHERWISE


def write() -> str:
    """Return a table of the words in a fault's text and the remedy."""
    rows = (f"| {words} | {advice} |" for words, advice in (*ADVICE, ("anything else", OTHERWISE)))
    return "\n".join(
        [
            "| in the fault's text | what to do |",
            "|---|---|",
            *rows,
            "",
            "Then start the display again.",
        ]
    )
