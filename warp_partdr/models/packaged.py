"""Findings about the packaged Anny that take long: its skin, and its reduced meshes. They are found once, in an asset.

``scripts/make_anny_findings.py`` makes the asset with the functions that find them for other models.
"""

from __future__ import annotations

import hashlib
from functools import lru_cache
from importlib import resources

import numpy as np

from .model import DetailedModel

FINDINGS = "assets/anny_findings.npz"


def packaged_findings(model: DetailedModel, name: str) -> dict[str, np.ndarray] | None:
    """Findings of a name about a model, which has the packaged one's surface; None: there are none.

    Args:
        model: Any.
        name: Name of the findings, with all numbers that they depend on beside the model's surface.
    """
    start = findings_start(model, name)
    found = {key.removeprefix(start): value for key, value in _asset().items() if key.startswith(start)}
    return found or None


@lru_cache(maxsize=8)  # a hundredth of a second
def findings_start(model: DetailedModel, name: str) -> str:
    """Start of the keys in the asset: the findings' name, and SHA-256 of the model's surface at rest."""
    vertices = model.rest_vertices.double().cpu().numpy()
    digest = hashlib.sha256()
    for array in (vertices, model.faces.cpu().numpy(), model.face_parts.cpu().numpy()):
        digest.update(np.ascontiguousarray(array).tobytes())
    return f"{name} of {digest.hexdigest()}: "


@lru_cache(maxsize=1)
def _asset() -> dict[str, np.ndarray]:
    path = resources.files("warp_partdr").joinpath(FINDINGS)
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}
