"""Differentiable rendering of body parts, and reconstruction of human pose and shape.

Importing this package loads nothing but itself: each public name is fetched from its module when it is first used
(PEP 562), so that neither torch nor Warp nor PyVista starts before it is needed, and no kernel is compiled.

A new public name goes into ``_EXPORTS`` and into the ``TYPE_CHECKING`` block; a test keeps the two alike.
"""

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

# Public name: the submodule that defines it. No name may be that of a submodule, which would hide it once imported.
_EXPORTS = {
    "JOINT_NAMES": "body.template",
    "LENGTH_NAMES": "body.template",
    "PART_NAMES": "body.template",
    "THICKNESS_NAMES": "body.template",
}
_SUBMODULES = ("body", "kernels")

__all__ = sorted(["__version__", *_EXPORTS])

if TYPE_CHECKING:
    from . import body as body
    from . import kernels as kernels
    from .body.template import JOINT_NAMES as JOINT_NAMES
    from .body.template import LENGTH_NAMES as LENGTH_NAMES
    from .body.template import PART_NAMES as PART_NAMES
    from .body.template import THICKNESS_NAMES as THICKNESS_NAMES
else:

    def __getattr__(name: str) -> object:
        """Fetch a public name from its submodule, once."""
        if name in _SUBMODULES:
            return import_module(f".{name}", __name__)
        if name not in _EXPORTS:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(f".{_EXPORTS[name]}", __name__), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_EXPORTS, *_SUBMODULES})
