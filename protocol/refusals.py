"""Causes for which connections, messages and samples are refused, and the words for each.

Every count of refusals has the cause's meaning: the printed summary and its verdict, the report and
the events of a recording, the live page's alarm "refused", and docs/reference/wire.md.

A present refusal of a client's connection has one text: the server's address, then `at_client`.
The client's log, the summary's `waiting_for`, the alert of terminal and live page, the event
"revoked" and the verdict on a run in which nothing was felt show that one. A server only logs a
refusal: its client's address, then `at_server`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

# Of a connection, counted by either end.
NO_KEY, NOT_AUTHENTIC, REPLAYED, HANDSHAKE = "no_key", "not_authentic", "replayed", "handshake"
# Counted by the server, the end that binds.
UNKNOWN_KEY, REVOKED_KEY, LIST_UNREADABLE = "unknown_key", "revoked_key", "list_unreadable"
TOO_MANY = "too_many_connections"
# Counted by the client, the end that connects: the first three of these, as far as it knows them.
REFUSED_KEY, REVOKED = "refused_key", "revoked"
SERVER_LIST_UNREADABLE = "server_list_unreadable"


@dataclass(frozen=True, slots=True)
class Reason:
    """Cause for which a display waits at one address, or for which its stream does not come."""

    text: str
    #: What it means, or what a person can do; a line without room for it has the text alone.
    further: str = ""

    def __str__(self) -> str:
        return "; ".join(filter(None, (self.text, self.further)))


class ConnectionWords(NamedTuple):
    """Words for a refused connection; a text without words belongs to the other end.

    meaning: of a count. at_server: after the client's address; {client} is the client's key, by
    `AllowList.describe`. at_client: after the server's address; {own} and {peer} are the public
    keys of client and server. without_keys: the same of a client that has no keys.
    """

    meaning: str
    at_server: str = ""
    at_client: Reason = Reason("")
    without_keys: Reason = Reason("breaks off as soon as it is connected", "check the address")


CONNECTIONS = {
    NO_KEY: ConnectionWords(
        "connections without a key to a node with one, or the reverse: give both --key and --peer",
        "it has no key",
        Reason(
            "has no keys", "start it with --key, or this node with --insecure in place of --key"
        ),
        Reason("requires a key", "give --key and --peer"),
    ),
    NOT_AUTHENTIC: ConnectionWords(
        "bytes not encrypted for this node: the peer has a wrong public key of it (--peer), or"
        " they were altered on the way",
        "it has a wrong public key of this node, or its bytes were altered on the way",
        Reason(
            "sends messages that {peer.name} has not encrypted",
            "they are forged, or altered on the way",
        ),
    ),
    REPLAYED: ConnectionWords(
        "encrypted messages that came twice or out of order: something repeats them",
        "its messages came twice or in another order",
        Reason("sends messages twice or in another order"),
    ),
    HANDSHAKE: ConnectionWords(
        "connections that ended before they were authenticated: no node, a wrong --peer, or a"
        " network that breaks off; an allowed node that connects again is not counted",
        "it made no ZeroMQ connection",
        Reason("breaks off", "it is not {peer.name}, whose public key --peer gives"),
    ),
    UNKNOWN_KEY: ConnectionWords(
        "peers whose key is not on this node's allow-list: telepulse keys allow adds it",
        "{client} is not allowed",
    ),
    REVOKED_KEY: ConnectionWords(
        "connections with a key that was allowed before and has been revoked",
        "{client} is no longer allowed",
    ),
    LIST_UNREADABLE: ConnectionWords(
        "connections refused while this node's changed allow-list cannot be read: its log names"
        " the reason",
        "the allow-list cannot be read, so that {client} may not connect now",
    ),
    TOO_MANY: ConnectionWords(
        "connections beyond this node's file descriptors, which were cut: a peer connects"
        " repeatedly, or the limit is too low (ulimit -n)",
        "more connections than this node has files for; it keeps the earlier ones",
    ),
    REFUSED_KEY: ConnectionWords(
        "connections refused because the other node's allow-list lacks this node's key",
        at_client=Reason(
            "does not allow the key of {own.name}", "there: telepulse keys allow {own.file_name}"
        ),
    ),
    REVOKED: ConnectionWords(
        "the other node allowed this node's key before and has revoked it; to undo that, run"
        " telepulse keys allow there",
        at_client=Reason(
            "has revoked the key of {own.name}: this node was connected and is no longer allowed",
            "to undo that, there: telepulse keys allow {own.file_name}",
        ),
    ),
    SERVER_LIST_UNREADABLE: ConnectionWords(
        "connections refused while the other node's allow-list cannot be read: its log names the"
        " reason and the remedy",
        at_client=Reason(
            "cannot read its allow-list",
            "it refuses every key until it can, and its log names the reason: correct the list"
            " there, no restart is needed",
        ),
    ),
}
# Cause → meaning, in one line.
CAUSE_MEANINGS = {
    # Messages between the nodes.
    "oversized": "messages above 64 KiB; no node of this project sends them",
    "truncated": "messages that end too early; the peer is no node, or bytes were lost",
    "not_msgpack": "bytes that are no message; the peer is no node, or bytes were altered",
    "version": "messages of another protocol version: run the same version on both nodes",
    "malformed": "messages with fields that do not fit; the peer is no node, or of another version",
    "not_finite": "samples that are NaN, infinite or beyond 1e6 N: check the sensor and its scale",
    "description": "an invalid stream description: check the sensing node's scene",
    "channel": "streams without a channel that the scene plays: compare `channel` in its [display]"
    " with the sensing node's source",
    "before_welcome": "frames that came before the stream's description; usual while joining",
    "session": "messages of an earlier session; usual after a restart of the sensing node",
    "before_clock": "frames that came before the clock offset was known; usual while joining",
    "mismatch": "frames that do not match the stream's description",
    "timestamp": "frames whose time is far from the present or does not fit their number:"
    " a clock was set, or the stream is forged",
    "duplicate": "samples or set-points that had arrived already",
    "overlap": "samples that had arrived already, in a frame cut differently",
    "too_old": "samples older than the buffer keeps",
    "overflow": "samples too far ahead of what is played",
    "implausible": "clock replies that arrive before their request was sent,"
    " or an end with an impossible number of samples",
    "unasked": "clock replies to an unknown or already answered request",
    "unexpected": "messages that only the other kind of node sends: check the address",
    "false_report": "reports of the probe that cannot be true",
    "press_held": "set-points of a display while another one presses",
    "no_probe": "set-points to a sensing node without a probe: add [sensing.press]",
    "flood": "messages dropped because a peer sent far more than it should:"
    " it is broken or hostile",
    "held_back": "times when a sensing node left messages unread for 5 ms:"
    " displays send far more than they should",
    "too_many_displays": "displays beyond the 1 000 that a sensing node serves: use a relay",
    "subscription": "subscriptions to topics that are not published here, or far too many marks;"
    " the connection was cut",
    "mark": "requests of a telemetry reader for marks that are malformed or older than a minute",
    # Live sensors.
    "partial": "the rest of a line or frame that began before this node listened",
    "framing": "bytes that are no frame: check baud rate and format",
    "crc": "frames with a wrong checksum: check the sensor's cable",
    "format": "frames of an unknown format: check the sensor's firmware",
    "not_a_number": "lines without a number in the scene's column",
    "labels": "lines with other labels than those before: set column to the label to be read",
    "unit": "numbers in another unit than the scene's: compare unit",
    "device_time": "lines whose device time does not follow the last",
    "counter": "sample counters that jump: the sensor lost samples or restarted",
    "not_decoded": "CAN messages that the database does not describe",
    "bus_error": "errors on the CAN bus: check cable, termination and bit rate",
    "behind": "samples whose time had long passed",
    "backlog": "reads dropped because the node did not fetch them in time",
    **{cause: words.meaning for cause, words in CONNECTIONS.items()},
}


def explain_causes(rejected: Mapping[str, int]) -> list[str]:
    """Return a line for each cause: its count, its name and its meaning."""
    return [
        f"{count} {cause}" + (f": {CAUSE_MEANINGS[cause]}" if cause in CAUSE_MEANINGS else "")
        for cause, count in sorted(rejected.items())
    ]
