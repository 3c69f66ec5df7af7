"""The paper's figures and numbers, computed again: the command `telepulse paper`."""
