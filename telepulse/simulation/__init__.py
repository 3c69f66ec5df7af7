"""Both nodes and the link between them in virtual time."""
