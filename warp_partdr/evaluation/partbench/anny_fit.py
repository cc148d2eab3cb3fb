"""The paper's "PartDR + SMPL", with Anny: after EllipBody's fit, the detailed mesh itself is drawn and refined."""

from __future__ import annotations

from collections.abc import Sequence

from ...fit.fitting import fit_body
from ...fit.mesh_options import MeshOptions
from ...fit.mesh_stage import MeshFit, refine_mesh
from ...fit.options import FitOptions
from ...inputs.keypoints import Keypoints2D
from ...inputs.part_labels import PartLabels


def fit_anny(
    keypoints: Keypoints2D,
    parts: PartLabels,
    *,
    others: Sequence[Keypoints2D] = (),
    options: FitOptions,
    mesh: MeshOptions | None = None,
    device: str = "cpu",
) -> MeshFit:
    """Fit EllipBody as ``fit_body`` does, but for its outline stage, and from there Anny (``refine_mesh``)."""
    first = fit_body(keypoints, parts, others=others, options=options.without_outline(), device=device)
    return refine_mesh(first, options=mesh)
