"""Methods that PartBench compares, by input of the fit, start, renderer and z gradient of hidden parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter

import numpy as np

from ....cameras import Perspective
from ....inputs.keypoints import Keypoints2D
from ....inputs.part_labels import PartLabels
from ....models.anny import anny
from ....models.registration import RegistrationOptions, RegistrationWeights, register
from ....solve.ellipsoids.fitting import fit_body
from ....solve.ellipsoids.options import FitOptions
from ....solve.ellipsoids.result import FitResult
from ....solve.mesh.mesh_options import MeshOptions
from ....solve.mesh.mesh_stage import MeshFit, refine_mesh
from ..evaluate import METHODS as SUPERVISIONS
from ..evaluate import Method

# A fit's own error is many times what more iterations would take off (1 to 3 mm of about 110 mm).
_REGISTRATION = RegistrationOptions(RegistrationWeights.fitted(), iterations=40)
_OUTLINE = FitOptions().with_outline()
_SEARCH = FitOptions.at("balanced", "search").with_outline()


def registered_vertices(result: FitResult) -> np.ndarray:
    """Vertices of the Anny that clothes a fitted EllipBody, camera frame [m], shape (V, 3)."""
    posed = result.posed
    return register(posed, anny(posed.joints.device), options=_REGISTRATION).detailed.vertices[0].cpu().numpy()


def fit_anny(
    keypoints: Keypoints2D,
    parts: PartLabels | None,
    *,
    others: Sequence[Keypoints2D] = (),
    options: FitOptions,
    mesh: MeshOptions | None = None,
    device: str = "cpu",
    camera: Perspective | None = None,
) -> MeshFit:
    """Fit EllipBody as ``fit_body`` does, and from there Anny (``refine_mesh``), by ``mesh`` or the options' own."""
    first = fit_body(keypoints, parts, others=others, options=options, device=device, camera=camera)
    return refine_mesh(first, options=mesh or options.mesh)


KNOWN_CAMERA = "parts, known camera"
NO_FLIPS = "parts, no depth flips"
_STARTS = {
    "network": Method(options=FitOptions(stages=(), search=())),
    "network, 50 iterations": Method(options=FitOptions.at("fast")),
    "search": Method(options=_SEARCH),
}
_MESH = Method(fit=fit_anny, vertices=attrgetter("vertices"))
_MESH_BY_PARTDR = MeshOptions(gradient="partdr", seg=0.03)  # which pulls about thrice as hard as "edges"
METHODS: dict[str, Method] = {
    **{name: replace(method, vertices=registered_vertices) for name, method in (SUPERVISIONS | _STARTS).items()},
    KNOWN_CAMERA: Method(options=_OUTLINE, camera=True, vertices=registered_vertices),
    NO_FLIPS: Method(options=replace(_OUTLINE, depth_flips=False), vertices=registered_vertices),
    # Of the starts' stages, only the search's have PartDR's rule, and with it a z gradient.
    "search, no z gradient": Method(
        options=_SEARCH.drawn_by(lambda old: replace(old, depth_weight=0.0)), vertices=registered_vertices
    ),
    "parts, Anny's mesh": _MESH,
    "parts, Anny's mesh, PartDR's rule": replace(_MESH, fit=partial(fit_anny, mesh=_MESH_BY_PARTDR)),
}
QUICK = ("keypoints only", "full silhouette", "parts", *_STARTS)
