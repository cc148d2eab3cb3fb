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

_SHOWN = 2.0  # [m], about: side of the crop of an adult


@dataclass(frozen=True)
class MeshOptions:
    """Options of the mesh stage; weights are of terms in the units of ``Energy``'s.

    Attributes:
        iterations: Steps of Adam.
        learning_rate: Of angles [rad] and camera [half-sides of the crop].
        size: Side of the drawn crop [px].
        vertices: Of the mesh that is drawn meanwhile (``reduce_model``), where the model has more; "auto": about as few
            as keep ``skin_error``.
        proj: Weight of L_proj.
        seg: Weight of L_seg.
        depth: Weight of the squares of joints' moves along the view, in spreads that the network stated.
        turns: Weight of the squares of joints' turns, in such spreads.
        shape: Weight of half the squares of changes of the shape values.
        clothes: Weight of the clothes' thicknesses, in their mean; None: the person wears none.
        noise: Of keypoints and labels: "unknown", so that those that the body agrees with count more, or "usual".
        apart: Weight of the squares of depths [cm] by which parts that are no neighbours stand in one another, beyond
            what flesh gives way; 0 leaves them out. 0.1 changes few people's parts, and no joints on average.
        gradient: Of L_seg, "edges" or "partdr", as ``mesh_label_loss``; "partdr" pulls about thrice as hard.
        max_distance: "partdr": greatest distance from an edge of a pixel that moves it [px].
        depth_weight: "partdr": the paper's lambda of the z gradient (eq. 12).
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
        """Options of a quality: "accurate" draws larger and steps on, in thrice the time; the others are alike."""
        return cls(size=256, iterations=150) if quality == "accurate" else cls()

    @property
    def skin_error(self) -> float:
        """Distance of the whole model's skin from the one drawn, 2 % of it aside: half a drawn pixel at most [m]."""
        return DEFAULT_TOLERANCE * _SHOWN / self.size

    @property
    def drawn_seg(self) -> float:
        """Weight of a pixel of L_seg as labels are drawn."""
        return self.seg * (REFERENCE_SIZE / self.size) ** 2
