"""Settings of the demo's refinement: what it follows, and how it draws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin, get_type_hints

from ..errors import InputError
from ..render.options import DEFAULT_DEPTH_WEIGHT, Gradient
from ..render.renderers import Renderer, RendererEllipsoids, RendererMesh

Supervision = Literal["keypoints", "silhouette", "parts"]
RendererName = Literal["exact", "E0", "E1", "E2", "E3"]

# Names of what is chosen between: a few renderers, gradients and sizes, from the fastest to the most accurate.
QUALITIES: dict[str, dict[str, Any]] = {
    "draft": {"renderer": "E0", "gradient": "partdr", "size": 64},
    "fast": {"renderer": "exact", "gradient": "edges", "size": 128},
    "paper": {"renderer": "E1", "gradient": "partdr", "size": 256},
    "exact": {"renderer": "exact", "gradient": "partdr", "size": 256},
    "fine": {"renderer": "exact", "gradient": "coverage", "size": 512},
}


@dataclass(frozen=True)
class Settings:
    """Settings of the refinement; ``files.sections`` reads them and checks their types."""

    supervision: Supervision = "parts"  # beside the keypoints: nothing, the whole silhouette, or the parts
    depth_gradient: bool = True  # whether PartDR's z gradient counts where there is one; see ``offers_depth``
    renderer: RendererName = "exact"  # ellipsoids, or their mesh of a level
    gradient: Gradient = "partdr"  # of the exact renderer; a mesh has PartDR's alone
    size: Literal[64, 128, 256, 512] = 256  # side of the drawn crop [px]
    steps: int = 100  # over which the learning rate falls to a tenth; it stays there
    learning_rate: float = 0.06  # as in ``refine``, whose own is for starts that are nearer

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise InputError(f"steps: {self.steps}; expected 1 or more")
        if not 0 < self.learning_rate <= 1:
            raise InputError(f"learning_rate: {self.learning_rate}; expected a positive number up to 1")

    @property
    def level(self) -> int | None:
        """Subdivisions of the mesh; None for exact ellipsoids."""
        return None if self.renderer == "exact" else int(self.renderer[1])

    @property
    def drawn_by(self) -> Renderer:
        """The renderer of these settings."""
        weight = DEFAULT_DEPTH_WEIGHT if self.depth_gradient else 0.0
        if self.level is None:
            return RendererEllipsoids(self.gradient, depth_weight=weight)
        return RendererMesh(self.level, depth_weight=weight)

    @property
    def offers_depth(self) -> bool:
        """True if PartDR's z gradient can be had: by its rule, which is a mesh's, too, of parts, which hide each other.

        The other gradients have one of their own, where parts pass through each other; it always counts.
        """
        return self.supervision == "parts" and (self.level is not None or self.gradient == "partdr")

    @property
    def has_depth(self) -> bool:
        """True if PartDR's z gradient counts."""
        return self.offers_depth and self.depth_gradient

    @property
    def drawn(self) -> str:
        """Renderer and gradient in words, such as "exact, partdr" or "mesh E1"."""
        return f"exact, {self.gradient}" if self.level is None else f"mesh {self.renderer}"


# Values of the settings that have but a few.
CHOICES = {name: get_args(kind) for name, kind in get_type_hints(Settings).items() if get_origin(kind) is Literal}
