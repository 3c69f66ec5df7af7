"""The targets, one file each.

A target has `seeds()`, small inputs to begin with, most of them valid, and `try_one(data)`, which
raises when a property does not hold. `MSGPACK = True`: its inputs are mutated as msgpack.
"""

import pkgutil

NAMES = tuple(sorted(module.name for module in pkgutil.iter_modules(__path__)))
