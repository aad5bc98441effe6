"""eqsim: the stochastic earthquake model of multi-contact friction, exact in time, with
honest error bars.

The public names are those of `eqsim.api`. They are imported when one is first used:
`eqsim --help` needs no numba.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eqsim.api import *  # noqa: F403

    __version__: str
else:
    from importlib import import_module, metadata
    from importlib.util import find_spec

    def __getattr__(name):
        if name == "__version__":
            return metadata.version("eqsim")
        if not name.startswith("_") and find_spec(f"eqsim.{name}"):
            return import_module(f"eqsim.{name}")
        if name == "__all__":
            public = vars(import_module("eqsim.api"))
            return sorted(name for name in public if not name.startswith("_"))
        if name.startswith("_") or name not in __getattr__("__all__"):
            raise AttributeError(f"module 'eqsim' has no attribute {name!r}")
        # the next time Python finds it at once
        globals()[name] = getattr(import_module("eqsim.api"), name)
        return globals()[name]

    def __dir__():
        return sorted([*__getattr__("__all__"), "__version__", "materials"])
