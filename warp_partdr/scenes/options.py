"""Options of a scene's fit."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ..errors import check_whole
from ..fit.mesh_options import MeshOptions
from ..interop.checks import MAX_PICTURE


@dataclass(frozen=True)
class SceneOptions:
    """Options of a scene's fit.

    Attributes:
        mesh: Of each person, and of the steps.
        smoothing: Standard deviation of the Gaussian by which starts, and all moves from there, are smooth in time
            [s]; 0 leaves frames to themselves.
        exchanges: Exchange people of a picture in depth where labels ask for it; else the order is the start's, but
            for a z gradient (``mesh.gradient``).
        together: Side of the crop in which several people are drawn together [px].
    """

    mesh: MeshOptions = field(default_factory=MeshOptions)
    smoothing: float = 0.035
    exchanges: bool = True
    together: int = 256

    def __post_init__(self) -> None:
        if not 0 <= self.smoothing < math.inf:
            raise ValueError(f"smoothing: {self.smoothing}; expected seconds, 0 or more")
        check_whole("together", self.together, 1, math.isqrt(MAX_PICTURE) - 1)

    def size_of(self, num_people: int) -> int:
        """Side of drawn crops [px]."""
        return self.mesh.size if num_people == 1 else self.together
