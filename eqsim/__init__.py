"""eqsim: the stochastic earthquake model of multi-contact friction, exact in time, with
honest error bars.

The public names are those of `eqsim.api`. They are imported when one is first used:
`eqsim --help` needs no numba.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eqsim.api import *  # noqa: F403
    from eqsim.api import __all__ as __all__

    __version__: str
else:
    from importlib import import_module, metadata
    from importlib.util import find_spec

    def __getattr__(name):
        if name == "__version__":
            return metadata.version("eqsim")
        if not name.startswith("_") and find_spec(f"eqsim.{name}"):
            return import_module(f"eqsim.{name}")
        private = name.startswith("__") and name != "__all__"
        public = {} if private else vars(import_module("eqsim.api"))
        if name not in ("__all__", *public.get("__all__", ())):
            raise AttributeError(f"module 'eqsim' has no attribute {name!r}")
        globals()[name] = public[name]  # the next time Python finds it at once
        return public[name]

    def __dir__():
        return sorted([*import_module("eqsim.api").__all__, "__version__", "materials"])
