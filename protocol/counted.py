"""Counts in words."""


def counted(count: int, singular: str, plural: str | None = None) -> str:
    """Return a count with its noun: "1 sample", "2 samples".

    Parameters
    ----------
    count
        How many there are.
    singular, plural
        The noun; without a plural, the singular and an s.
    """
    return f"{count} {singular if count == 1 else plural or singular + 's'}"
