"""Options of the mesh stage."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from ...errors import check_whole
from ...inputs.observation import REFERENCE_SIZE
from ...interop.checks import MAX_PICTURE, check_steps
from ...models.reduction import LEAST_VERTICES
from ...render.options import DEFAULT_DEPTH_WEIGHT, MeshGradient, check_mesh_rule
from ...render.subdivisions import DEFAULT_TOLERANCE
from ..ellipsoids.stages import Quality

_CROP_SIDE = 2.0  # usual side of an adult's crop [m]


@dataclass(frozen=True)
class MeshOptions:
    """Options of the mesh stage. The terms have the units of ``Energy``'s terms.

    Attributes:
        iterations: Number of steps of Adam.
        learning_rate: Learning rate of angles [rad] and of the camera [half-sides of the crop] at the first step.
        size: Side of the drawn crop [px].
        vertices: Number of vertices of the mesh that is drawn in the fit (``reduce_model``), if the model has more.
            "auto" takes about as few as ``skin_error`` allows.
        proj: Weight of L_proj.
        seg: Weight of L_seg.
        depth: Weight of the squared moves of joints along the view, in units of the network's uncertainty.
        turns: Weight of the squared turns of joints, in units of the network's uncertainty.
        shape: Weight of half the squared changes of the shape values.
        clothes: Weight of the clothes' thicknesses, in units of their mean; None: the person wears no clothes.
        noise: Size of the noise of keypoints and labels. With "unknown", keypoints and labels count more if the body
            agrees with them; with "usual" their costs are plain sums.
        apart: Weight of the squared depths [cm] by which parts that are no neighbours penetrate each other, beyond
            the depth by which flesh gives way; 0 leaves the term out. 0.1 changes few people's parts, and no joints on
            average.
        gradient: Gradient of L_seg, "edges" or "partdr" (see ``mesh_label_loss``); "partdr" pulls about three times as
            hard.
        max_distance: Largest distance of an edge from a pixel that moves it, with "partdr" [px].
        depth_weight: Lambda of the paper's z gradient (eq. 12), with "partdr".
    """

    iterations: int = 60
    learning_rate: float = 0.01
    size: int = 160
    vertices: int | Literal["auto"] = "auto"
    proj: float = 0.5
    seg: float = 0.1
    depth: float = 2.0
    turns: float = 4.0
    shape: float = 1.0
    clothes: float | None = 1.0
    noise: Literal["unknown", "usual"] = "unknown"
    apart: float = 0.0
    gradient: MeshGradient = "edges"
    max_distance: float = 3.0
    depth_weight: float = DEFAULT_DEPTH_WEIGHT

    def __post_init__(self) -> None:
        check_steps(self.iterations, self.learning_rate)
        check_whole("size", self.size, 1, math.isqrt(MAX_PICTURE) - 1)
        if self.vertices != "auto":
            check_whole("vertices", self.vertices, LEAST_VERTICES)
        if self.noise not in ("unknown", "usual"):
            raise ValueError(f"noise: {self.noise!r}; expected 'unknown' or 'usual'")
        check_mesh_rule(self.gradient, self.max_distance, self.depth_weight)
        for name in ("proj", "seg", "depth", "turns", "shape", "clothes", "apart"):
            weight = getattr(self, name)
            if not (0 <= weight < math.inf if weight is not None else name == "clothes"):
                raise ValueError(f"{name}: {weight}; expected 0 or a positive number")

    @classmethod
    def at(cls, quality: Quality) -> MeshOptions:
        """Return the options of a quality.

        "accurate" draws larger pictures and takes more steps, in about three times the time. "fast" and "balanced" have
        the same options.
        """
        return cls(size=256, iterations=150) if quality == "accurate" else cls()

    @property
    def skin_error(self) -> float:
        """Largest distance of the drawn skin from the whole model's, for 98 % of the skin: half a drawn pixel [m]."""
        return DEFAULT_TOLERANCE * _CROP_SIDE / self.size

    @property
    def drawn_seg(self) -> float:
        """Weight of one wrong pixel of the drawn crop; ``seg`` is that of a pixel of a crop of ``REFERENCE_SIZE``."""
        return self.seg * (REFERENCE_SIZE / self.size) ** 2
