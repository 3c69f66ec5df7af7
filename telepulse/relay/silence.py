"""Whether a connection is dead: asked, it says nothing."""


class Silence:
    """Watches counts of what was asked and what was heard. Pure: time comes in.

    once_heard: it says nothing of a connection that nothing has come over yet.
    """

    def __init__(self, patience_ns: int, once_heard: bool = False) -> None:
        self._patience_ns = patience_ns
        self._once_heard = once_heard
        self._speaks = not once_heard
        self._asked = self._heard = 0
        self._since_ns: int | None = None

    def lasts(self, now_ns: int, asked: int, heard: int) -> bool:
        """Whether nothing has been heard for longer than the patience after something was asked.

        Where nothing is asked, as without displays, nothing need be heard.
        """
        if heard != self._heard:
            self._since_ns = None
            self._speaks = True
        elif asked != self._asked and self._since_ns is None:
            self._since_ns = now_ns
        self._asked, self._heard = asked, heard
        if self._since_ns is None or not self._speaks:
            return False
        return now_ns - self._since_ns >= self._patience_ns

    def begin_anew(self) -> None:
        """Be patient again: the connection is new."""
        self._since_ns = None
        self._speaks = not self._once_heard
