"""Methods that PartBench compares, by input of the fit, start, renderer and z gradient of hidden parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter

import numpy as np

from ...clothing.anny import anny
from ...clothing.registration import RegistrationOptions, RegistrationWeights, register
from ...errors import InputError
from ...fit.options import FitOptions
from ...fit.result import FitResult
from ...render.renderers import Renderer
from ..evaluate import METHODS as SUPERVISIONS
from ..evaluate import Method
from .anny_fit import fit_anny

# A fit's own error is many times what more iterations would take off (1 to 3 mm of about 110 mm).
_REGISTRATION = RegistrationOptions(RegistrationWeights.fitted(), iterations=40)
_SEARCH = FitOptions.at("balanced", "search")


def registered_vertices(result: FitResult) -> np.ndarray:
    """Vertices of the Anny that clothes a fitted EllipBody, camera frame [m], shape (V, 3)."""
    posed = result.posed
    return register(posed, anny(posed.joints.device), options=_REGISTRATION).detailed.vertices[0].cpu().numpy()


def _without_depth(renderer: Renderer) -> Renderer:
    return replace(renderer, depth_weight=0.0)


_STARTS = {
    "network": Method(options=FitOptions(stages=(), search=())),
    "network, 50 iterations": Method(options=FitOptions.at("fast")),
    "search": Method(options=_SEARCH),
}
METHODS: dict[str, Method] = {
    **{name: replace(method, vertices=registered_vertices) for name, method in (SUPERVISIONS | _STARTS).items()},
    # Of the starts' stages, only the search's have PartDR's rule, and with it a z gradient.
    "search, no z gradient": Method(options=_SEARCH.drawn_by(_without_depth), vertices=registered_vertices),
    "parts, Anny's mesh": Method(fit=fit_anny, vertices=attrgetter("vertices")),
    "parts, Anny's mesh, no z gradient": Method(
        fit=partial(fit_anny, depth_weight=0.0), vertices=attrgetter("vertices")
    ),
}
QUICK = ("keypoints only", "full silhouette", "parts", *_STARTS)


def choose_methods(names: Sequence[str]) -> dict[str, Method]:
    """Some of ``METHODS``, in its order.

    Raises:
        InputError: If a name is not there.
    """
    if unknown := [name for name in names if name not in METHODS]:
        raise InputError(f"method: {', '.join(unknown)}; expected {'; '.join(METHODS)}")
    return {name: method for name, method in METHODS.items() if name in names}
