"""The causes that refused messages and peers are counted under, each with its meaning in a line."""

from collections.abc import Mapping

MEANINGS = {
    # Messages between the nodes.
    "oversized": "messages above 64 KiB; no node of this project sends them",
    "truncated": "messages that end too early; the peer is no node, or bytes were lost",
    "not_msgpack": "bytes that are no message; the peer is no node, or bytes were altered",
    "version": "messages of another protocol version: run the same version on both nodes",
    "malformed": "messages with fields that do not fit; the peer is no node, or of another version",
    "not_finite": "samples that are NaN or infinite: check the sensor",
    "description": "a stream description that cannot be: check the sensing node's scene",
    "before_welcome": "frames that came before the stream's description; usual while joining",
    "session": "messages of an earlier session; usual after a sensing node was started anew",
    "before_clock": "frames that came before the clock offset was known; usual while joining",
    "mismatch": "frames that do not match the stream's description",
    "timestamp": "frames whose time is far from the present or does not fit their number:"
    " a clock was set, or the stream is forged",
    "duplicate": "samples that had arrived already",
    "overlap": "samples that had arrived already, in a frame cut differently",
    "too_old": "samples older than the buffer keeps",
    "overflow": "samples too far ahead of what is played",
    "implausible": "clock replies before their request, or an end there was no time for",
    "unasked": "clock replies to no request of this node",
    "unexpected": "messages that only the other kind of node sends: check the address",
    "flood": "messages dropped because a peer sent far more than it should:"
    " it is broken or hostile",
    "held_back": "times when a sensing node left messages unread for 5 ms:"
    " displays send far more than they should",
    "too_many_displays": "displays beyond the 1 000 that a sensing node serves: use a relay",
    "subscription": "subscriptions to topics that are not published here; the connection was cut",
    "too_many_connections": "connections beyond what this node has files for, which were cut:"
    " somebody connects again and again, or raise the limit by ulimit -n",
    # Connections, where keys are used.
    "no_key": "connections without a key to a node with one, or the reverse:"
    " give both --key and --peer",
    "unknown_key": "peers whose key is not on this node's allow-list: telepulse keys allow adds it",
    "revoked_key": "connections with a key that was allowed before and has been revoked",
    "list_unreadable": "connections refused while this node's changed allow-list cannot be read:"
    " its log names the reason",
    "revoked": "the other node allowed this node's key before and has revoked it;"
    " to undo that, there: telepulse keys allow",
    "not_authentic": "bytes not encrypted for this node: the peer has a wrong public key of it"
    " (--peer), or they were altered on the way",
    "replayed": "encrypted messages that came twice or out of order: somebody repeats them",
    "handshake": "connections that ended before they were authenticated:"
    " no node, a wrong --peer, or a network that breaks off",
    "refused_key": "connections refused because the other node's allow-list lacks this node's key",
    # Live sensors.
    "partial": "the rest of a line or frame that began before this node listened",
    "framing": "bytes that are no frame: check baud rate and format",
    "crc": "frames with a wrong checksum: check the sensor's cable",
    "format": "frames of an unknown format: check the sensor's firmware",
    "not_a_number": "lines without a number in the scene's column",
    "device_time": "lines whose device time does not follow the last",
    "counter": "sample counters that jump: the sensor lost samples or restarted",
    "not_decoded": "CAN messages that the database does not describe",
    "bus_error": "errors on the CAN bus: check cable, termination and bit rate",
    "behind": "samples whose time had long passed",
    "backlog": "reads dropped because the node did not fetch them in time",
}


def explain(rejected: Mapping[str, int]) -> list[str]:
    """Return a line for each cause: how often, its name and its meaning."""
    return [
        f"{count} {cause}" + (f": {MEANINGS[cause]}" if cause in MEANINGS else "")
        for cause, count in sorted(rejected.items())
    ]
