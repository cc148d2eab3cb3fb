"""Figures of bodies, fits and gradients, and pictures of bodies as arrays.

Matplotlib draws the figures; it is loaded when the first name is used.
"""

from typing import TYPE_CHECKING

from ._lazy import lazy_names

_EXPORTS = {
    "PART_COLOURS": "results.palette",
    "blend": "results.shading",
    "shade_body": "results.shading",
    "shade_detailed": "results.shading",
    "turntable_views": "results.shading",
    "compare_bodies": "results.figures",
    "gradient_field": "results.figures",
    "loss_curve": "results.figures",
    "overlay": "results.figures",
    "part_panels": "results.figures",
    "turntable": "results.figures",
}

__all__ = sorted(_EXPORTS)

if TYPE_CHECKING:
    from .results.figures import compare_bodies as compare_bodies
    from .results.figures import gradient_field as gradient_field
    from .results.figures import loss_curve as loss_curve
    from .results.figures import overlay as overlay
    from .results.figures import part_panels as part_panels
    from .results.figures import turntable as turntable
    from .results.palette import PART_COLOURS as PART_COLOURS
    from .results.shading import blend as blend
    from .results.shading import shade_body as shade_body
    from .results.shading import shade_detailed as shade_detailed
    from .results.shading import turntable_views as turntable_views
else:
    __getattr__ = lazy_names(__name__, _EXPORTS)


def __dir__() -> list[str]:
    """Public names alone."""
    return list(__all__)
