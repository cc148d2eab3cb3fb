"""Methods that are compared on views of real people: fits of keypoints alone, and of the photo alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...errors import InputError
from ...inputs.keypoints import Keypoints2D, person_height
from ...inputs.sample import Sample
from ...networks.detection import PackagedParts
from ...pipelines.photo import fit_photo
from ...solve.ellipsoids.options import FitOptions
from ...solve.ellipsoids.stages import Quality
from ...solve.mesh.mesh_stage import MeshFit
from .evaluate import Fitting, Method, no_labels
from .partbench.methods import fit_anny
from .scoring import Score, score_fit

NETWORK, ELLIPSOIDS, MESH, PHOTO = "network", "ellipsoids", "mesh", "photo alone"
MASK, KEYPOINTS = "photo alone, mask", "photo alone, keypoints"
PAIRS = ((MESH, NETWORK), (ELLIPSOIDS, NETWORK), (PHOTO, MESH), (PHOTO, MASK), (MASK, KEYPOINTS))
_NOBODY = 0.5  # mean distance of keypoints, as a share of the person's height, beyond which it is somebody else


@dataclass(frozen=True)
class PhotoMethod:
    """Fit of the photo alone: of everybody in it, the person whose keypoints are nearest to the true ones counts."""

    options: FitOptions = field(default_factory=FitOptions)
    camera: bool = False  # a sample's is given to the fit, where it is known
    stature: bool = False  # likewise
    parts_from: PackagedParts = "packaged"

    def serves(self, sample: Any) -> bool:
        """True for people of whom there is a picture."""
        return isinstance(sample, Sample) and sample.picture is not None

    def fit_sample(self, sample: Sample, device: str) -> MeshFit:
        """Fit everybody in the photo, and return the person's body.

        Raises:
            InputError: If the picture can't be read, or the person is not found.
        """
        options = replace(self.options, stature=sample.stature) if self.stature else self.options
        camera = sample.camera if self.camera else None
        picture = sample.read_picture()
        found = fit_photo(picture, options=options, device=device, camera=camera, parts_from=self.parts_from)
        apart = {
            index: _keypoint_distance(sample.keypoints, person.keypoints) for index, person in enumerate(found.people)
        }
        nearest = min(apart, key=apart.__getitem__)
        share = apart[nearest] / max(person_height(sample.keypoints), 1.0)
        if not share < _NOBODY:
            raise InputError(f"photo: nobody found there, {share:.2f} heights off; expected the person")
        return found.fits[nearest]

    def score(self, sample: Sample, name: str, result: MeshFit, seconds: float) -> Score:
        """Compare the result with what is known of the sample."""
        return score_fit(sample, name, result, seconds)


def _keypoint_distance(keypoints: Keypoints2D, other: Keypoints2D) -> float:
    """Mean distance of the visible keypoints to another person's of the same names [px]; infinite if none has one."""
    theirs = other.format.landmarks
    names = list(zip(keypoints.format.landmarks, keypoints.visible.tolist(), strict=True))
    own = [row for row, (name, visible) in enumerate(names) if visible and name in theirs]
    if not own:
        return math.inf
    rows = [theirs.index(names[row][0]) for row in own]
    return float(np.linalg.norm(keypoints.points[own] - other.points[rows], axis=1).mean())


def real_methods(
    quality: Quality = "balanced",
    *,
    camera: bool = False,
    stature: bool | float = False,
    network: str | None = None,
) -> dict[str, Fitting]:
    """The methods by name.

    Args:
        quality: Quality of the ellipsoids' stages and of the mesh stage, as ``FitOptions.at`` knows them.
        camera: A sample's is given.
        stature: A sample's is given, or one for all [m].
        network: File of a label network of `partdr train`. If it is None, the packaged one is taken.

    Examples:
        >>> from warp_partdr.benchmark import real_methods
        >>> list(real_methods())
        ['network', 'ellipsoids', 'mesh', 'photo alone', 'photo alone, mask', 'photo alone, keypoints']
    """
    known = None if isinstance(stature, bool) else stature
    options = replace(FitOptions.at(quality), network=network, stature=known)
    with_stature = stature is True
    return {
        NETWORK: Method(no_labels, replace(options, stages=(), search=()), camera=camera, stature=with_stature),
        ELLIPSOIDS: Method(no_labels, options, camera=camera, stature=with_stature),
        MESH: Method(no_labels, options, fit_anny, camera=camera, stature=with_stature),
        PHOTO: PhotoMethod(options, camera=camera, stature=with_stature),
        MASK: PhotoMethod(options, camera=camera, stature=with_stature, parts_from="mask"),
        KEYPOINTS: PhotoMethod(options, camera=camera, stature=with_stature, parts_from="none"),
    }
