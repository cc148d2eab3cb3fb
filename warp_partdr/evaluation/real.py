"""Methods that are compared on views of real people, whose keypoints alone are known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ..fit.options import FitOptions
from .evaluate import Method, no_labels
from .partbench.methods import fit_anny

NETWORK, ELLIPSOIDS, MESH = "network", "ellipsoids", "mesh"
METHODS: Mapping[str, Method] = {
    NETWORK: Method(no_labels, FitOptions(stages=(), search=())),
    ELLIPSOIDS: Method(no_labels),
    MESH: Method(no_labels, fit=fit_anny),
}
PAIRS = ((MESH, NETWORK), (ELLIPSOIDS, NETWORK))


def real_methods(
    *, camera: bool = False, stature: bool | float = False, network: str | None = None
) -> dict[str, Method]:
    """The methods, which are told more than keypoints.

    Args:
        camera: A sample's is given.
        stature: A sample's is given, or one for all [m].
        network: File of a label network of `partdr train`; None: the packaged one.
    """
    height = None if isinstance(stature, bool) else stature
    return {
        name: replace(
            method,
            camera=camera,
            stature=stature is True,
            options=replace(method.options, network=network, stature=height),
        )
        for name, method in METHODS.items()
    }
