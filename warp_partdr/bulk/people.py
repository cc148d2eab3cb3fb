"""Fitter of everyone in pictures: people are found, the label network says their bodies, and stages refine them."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from ..inputs.cut_people import CutPeople
from ..inputs.observation import LABEL_SIZE
from ..models.model import DetailedModel
from ..networks.detection import MIN_SCORE
from ..networks.regression.label_network import LabelNetwork
from ..solve.ellipsoids.depth_flips import FLIP_SIZE
from ..solve.ellipsoids.fitting import fit_people
from ..solve.ellipsoids.options import FitOptions
from ..solve.ellipsoids.plausibility import JUDGED_SIZE
from ..solve.mesh.mesh_stage import refine_meshes
from .batches import FindRule, people_threads, with_found_people
from .cutting import Cutter
from .rows import RowPart, describe_bodies
from .sources import SourcePicture

BulkQuality = Literal["network", "fast", "mesh"]

_MESHES = threading.Lock()  # a mesh stage keeps the buffers of the last one


def stages_of_quality(quality: BulkQuality) -> FitOptions:
    """Options of the ellipsoids' fit: none, of ``partdr fit --quality fast``, or of what a mesh stage goes on from.

    No search is tried for those who end far from what was seen: it takes seconds a person. Warnings tell of them.
    Keypoints are those of the smaller landmark network: of many people, the larger one would take most of the time.
    """
    if quality == "network":
        return replace(FitOptions.at("fast"), stages=(), search=())
    if quality == "fast":
        return replace(FitOptions.at("fast"), search=())
    return replace(FitOptions.at("balanced"), landmarks="full", search=())


def kept_label_size(options: FitOptions, network: LabelNetwork, *, meshes: bool) -> int:
    """Side [px] at which labels of cut out people are kept for ``fit_people``, and for the mesh stage, too.

    ``LABEL_SIZE``; but where all look at one size that these can be thinned to, that one: 128 px take a 25th of the
    memory.
    """
    sizes = {network.config.size, JUDGED_SIZE, FLIP_SIZE, *(stage.size for stage in options.stages)}
    (least, *more) = sorted(sizes | ({options.mesh.size} if meshes else set()))
    return LABEL_SIZE if more or LABEL_SIZE % (2 * least) != least else least


@dataclass(frozen=True)
class PeopleFitter:
    """Fitter of everyone in pictures: it finds people, predicts their bodies and refines them.

    Attributes:
        options: Options of the fits, such as ``stages_of_quality``. With ``half``, people are found in float16 on CUDA.
        network: Network on the device, in evaluation mode.
        model: Detailed model on the device. If there is one, the mesh stage makes the detailed body, too.
        device: Device, "cpu" or a CUDA device.
        batch: Number of people that are fitted at a time.
        min_score: Least confidence that there is a person, for people who are found.
        cutter: Object that cuts people out of pictures.

    Examples:
        >>> from pathlib import Path
        >>> from warp_partdr import FitOptions, PeopleFitter, load_label_network, open_source
        >>> fitter = PeopleFitter(FitOptions.at("fast"), load_label_network())
        >>> (picture,) = fitter.find([open_source(Path("pictures")).read("photo.png")])
        >>> len(picture.people)
        1
    """

    options: FitOptions
    network: LabelNetwork
    model: DetailedModel | None = None
    device: str = "cpu"
    batch: int = 16
    min_score: float = MIN_SCORE
    cutter: Cutter = field(default_factory=Cutter)

    @property
    def workers(self) -> int:
        """Threads that find and fit people."""
        return people_threads(self.device)

    def find(self, pictures: Sequence[SourcePicture]) -> list[SourcePicture]:
        """Pictures with their people, found in one batch."""
        rule = FindRule(self.min_score, self.options.landmarks, self.options.half)
        return with_found_people(pictures, rule, self.device)

    def bodies(self, people: CutPeople) -> list[RowPart]:
        """Bodies of people, in one batch."""
        fits = fit_people(people, self.options, self.network)
        if self.model is None:
            return describe_bodies(fits)
        with _MESHES:
            meshes = refine_meshes(fits, self.model, options=self.options.mesh)
        return describe_bodies(meshes)
