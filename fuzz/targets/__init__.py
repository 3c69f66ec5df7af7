"""What is fuzzed, one file a target.

A target has `seeds()`, small inputs to begin with, most of them valid, and `try_one(data)`, which
raises what must not be. `MSGPACK = True`: its inputs are msgpack, and are changed as such.
"""

import pkgutil

NAMES = tuple(sorted(module.name for module in pkgutil.iter_modules(__path__)))
