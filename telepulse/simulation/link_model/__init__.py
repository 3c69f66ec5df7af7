"""A model of a network link, pure: it says when a packet or a message arrives, or that it is lost.

The same model carries the simulation's messages in virtual time, a relay's between two nodes, and
real IP packets in the emulator.
"""

from telepulse.simulation.link_model.direction import Direction
from telepulse.simulation.link_model.messages import MessageLink
from telepulse.simulation.link_model.scene import LinkScene, parse_link

__all__ = ["Direction", "LinkScene", "MessageLink", "parse_link"]
