"""How many connections a process may have.

Two of each display's stay open. At the limit ZeroMQ can take no further one, tries for it again
and again, and has less time for those that are there.
"""

import sys

# For a thousand displays, and to spare.
FILES = 4_096


def allow_connections() -> None:
    """Let this process have `FILES` open, or as many as the system allows; call before it binds."""
    if sys.platform == "win32":  # which has no such limit
        return
    import resource

    present, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = FILES if most == resource.RLIM_INFINITY else min(FILES, most)
    if present != resource.RLIM_INFINITY and present < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))
