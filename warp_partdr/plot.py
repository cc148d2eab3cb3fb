"""Figures of bodies, fits and gradients, and pictures of bodies as arrays.

Matplotlib draws the figures; it is loaded when the first name is used.
"""

from typing import TYPE_CHECKING

from ._lazy import lazy_names

_EXPORTS = {
    "PART_COLOURS": "results.palette",
    "blend": "results.pictures",
    "shade_body": "results.pictures",
    "shade_detailed": "results.pictures",
    "turntable_views": "results.pictures",
    "compare_bodies": "results.plot",
    "gradient_field": "results.plot",
    "loss_curve": "results.plot",
    "overlay": "results.plot",
    "part_panels": "results.plot",
    "turntable": "results.plot",
}

__all__ = sorted(_EXPORTS)

if TYPE_CHECKING:
    from .results.palette import PART_COLOURS as PART_COLOURS
    from .results.pictures import blend as blend
    from .results.pictures import shade_body as shade_body
    from .results.pictures import shade_detailed as shade_detailed
    from .results.pictures import turntable_views as turntable_views
    from .results.plot import compare_bodies as compare_bodies
    from .results.plot import gradient_field as gradient_field
    from .results.plot import loss_curve as loss_curve
    from .results.plot import overlay as overlay
    from .results.plot import part_panels as part_panels
    from .results.plot import turntable as turntable
else:
    __getattr__ = lazy_names(__name__, _EXPORTS)


def __dir__() -> list[str]:
    """Public names alone."""
    return list(__all__)
