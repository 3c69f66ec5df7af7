"""`display-node --doctor`: what this host grants a real-time loop, and how late its ticks are."""

from display_node.doctor.command import run_doctor

__all__ = ["run_doctor"]
