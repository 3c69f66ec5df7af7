"""A model of a network link, pure: it says when a packet or a message arrives, or that it is lost.

The same model carries the simulation's messages in virtual time, a relay's between two nodes, and
real IP packets in the emulator.
"""

from telepulse.link.direction import Direction
from telepulse.link.messages import MessageLink
from telepulse.link.scene import LinkScene, parse_link

__all__ = ["Direction", "LinkScene", "MessageLink", "parse_link"]
