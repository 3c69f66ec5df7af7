"""Blocks of ticks, made by hand."""

from collections.abc import Sequence

from protocol.ticks import TickBlock, TickState
from protocol.wire.telemetry import TraceWriter

TRACE_TICKS = 20


def tick_block(*ticks: TickState, others: Sequence[TickState] = ()) -> TickBlock:
    """Return consecutive ticks; others: states of further contactors, at each tick."""
    block = TickBlock(1 + len(others), max(1, len(ticks)))
    for tick in ticks:
        block.add([tick, *others])
    return block


def packed_trace(*ticks: TickState, others: Sequence[TickState] = ()) -> bytes:
    """Return ticks as a trace."""
    writer = TraceWriter()
    if ticks:
        writer.add(tick_block(*ticks, others=others))
    return writer.rest() or b""
