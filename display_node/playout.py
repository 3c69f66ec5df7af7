"""The instant of the pulse that is played, and the samples that show it. Pure.

At time t the finger feels the pulse of t − E. E is the perceived delay, which the summary calls the
playout delay: a fixed one (the scene's `compensation`), or the delay that the link requires, of
which a trusted predictor replaces a part. `Playout` chooses E and reads the buffer each tick;
`PlayoutClock` follows E without a jump.
"""

from display_node.contactor import Contactor
from display_node.prediction.trust import Trust
from display_node.reception.playout_clock import PlayoutClock
from display_node.reception.receiver import Receiver
from display_node.scene import DisplayScene
from protocol.ticks import NOT_PLAYED

# Contactors that play the same samples, which are read once: their `sample_lead_ns`, the number of
# values, and their places in the buffer.
Group = tuple[int, int, list[int], list[Contactor]]


class Playout:
    """Choice of the played instant, which is the same for all contactors of a display.

    It ends at the reference that `Contactor.play` stores; `Display.command` then has it bounded and
    commanded.

    The receiver owns samples, sensing clock and link delay, and replaces them in a new session:
    they are read from it each tick. The playout owns the played instant, and E with its reasons.

    Attributes
    ----------
    trust
        Trust in the predictor; None where E is fixed, or the predictor's errors are unknown.
    """

    def __init__(
        self, scene: DisplayScene, receiver: Receiver, contactors: list[Contactor]
    ) -> None:
        self._receiver, self._contactors = receiver, contactors
        # Copies: attributes of a scene take longer to read.
        self._tick_ns, self._compensation = scene.tick_ns, scene.compensation_ns
        self._stale_after_ns = scene.safety.stale_after_ns
        self._estimates_error = scene.predictor.estimates_error
        self._noticed_target = scene.noticed_target
        self._clock = PlayoutClock()
        self.trust = self._new_trust()
        self._groups: list[Group] = []
        # The largest of any contactor.
        self._sample_lead_ns = self._reserve_ns = 0

    def begin(self) -> None:
        """Begin a session, after the contactors have begun it."""
        contactors = self._contactors
        self._clock = PlayoutClock()
        self.trust = self._new_trust()
        self._groups = self._group()
        self._sample_lead_ns = max(contactor.sample_lead_ns for contactor in contactors)
        self._reserve_ns = max(contactor.reserve_ns for contactor in contactors)
        if len(contactors) > 1:
            leads_ns = (contactor.sample_lead_ns for contactor in contactors)
            self._receiver.buffer.keep_accounts([self._sample_lead_ns - each for each in leads_ns])

    def play(self, now_ns: int, full: bool, at_rest: bool = False) -> bool:
        """Play the instant that is due on all contactors; return whether the pulse is alive.

        full: whether the pulse was felt at full strength in the last tick. at_rest: after a fault
        no finger feels it, so that it counts neither as played nor as predicted.
        """
        receiver, contactors = self._receiver, self._contactors
        contactors[0].state.predicted_ns = NOT_PLAYED
        buffer, delay_ns = receiver.buffer, receiver.link_delay.delay_ns
        newest_ns = buffer.newest_ns
        if not receiver.ready or delay_ns is None or newest_ns is None:
            for contactor in contactors:
                contactor.rest(now_ns)
            return False
        sensing_now_ns, trusted = receiver.clock.remote_ns(now_ns), False
        playout_delay_ns, trust = self._compensation, self.trust
        if not isinstance(playout_delay_ns, int):
            playout_delay_ns = delay_ns + self._reserve_ns
            if trust is not None:
                age_ns, trusted = sensing_now_ns + self._sample_lead_ns - newest_ns, trust.given
                playout_delay_ns = trust.observe(now_ns, age_ns, playout_delay_ns)
        instant_ns = self._clock.instant(now_ns, sensing_now_ns - playout_delay_ns)
        # The sensing chain delays the pulse by its group delay: the pulse of `instant_ns` is in the
        # sample taken that much later. The actuators' lags are compensated in the same way.
        latest_ns = instant_ns + self._sample_lead_ns
        live = receiver.live(latest_ns, sensing_now_ns, self._stale_after_ns)
        buffer.advance(latest_ns, live and trusted)
        felt = live and not at_rest
        alive, longest_ns = felt, 0
        for sample_lead_ns, count, places, group in self._groups:
            sampled_ns = instant_ns + sample_lead_ns
            received = buffer.known(self._tick_ns, count, sampled_ns, places)
            for contactor, wrist_n in zip(group, received, strict=True):
                state = contactor.state
                state.now_ns, state.sensing_now_ns = now_ns, sensing_now_ns
                state.instant_ns, state.trusted = instant_ns, trusted
                predicted_ns = contactor.play(wrist_n, sampled_ns, newest_ns, felt, full)
                if predicted_ns == NOT_PLAYED:
                    alive = False
                elif predicted_ns > longest_ns:
                    longest_ns = predicted_ns
        if alive:
            contactors[0].state.predicted_ns = longest_ns
        return alive

    def work(self) -> bool:
        """Choose E anew where that is due; return whether it was."""
        if self.trust is None or not self.trust.due:
            return False
        contactors = self._contactors
        noticed = max(each.noticed_5s for each in contactors)
        self.trust.choose([each.expected for each in contactors], noticed)
        return True

    def _new_trust(self) -> Trust | None:
        if isinstance(self._compensation, int) or not self._estimates_error:
            return None
        return Trust(self._compensation, self._noticed_target)

    def _group(self) -> list[Group]:
        """Return the contactors by the samples that they play, the first one first."""
        groups: dict[tuple[int, int], tuple[list[int], list[Contactor]]] = {}
        for place, contactor in enumerate(self._contactors):
            key = contactor.sample_lead_ns, contactor.reference_ticks
            places, group = groups.setdefault(key, ([], []))
            places.append(place)
            group.append(contactor)
        return [(*key, *members) for key, members in groups.items()]
