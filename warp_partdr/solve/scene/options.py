"""Options of a scene's fit."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ...body.stature import check_stature
from ...errors import InputError, check_whole
from ...interop.checks import MAX_PICTURE
from ...networks.detection import LandmarkNetwork, check_landmark_network
from ..mesh.mesh_options import MeshOptions


@dataclass(frozen=True)
class SceneOptions:
    """Options of a scene's fit.

    Attributes:
        mesh: Of each person, and of the steps.
        smoothing: Standard deviation of the Gaussian by which all moves from the start are smooth in time [s], starts
            two thirds as much; 0 leaves frames to themselves.
        apart: ``MeshOptions.apart`` of scenes of several people, who stand in one another as little as their parts do.
        ground: Weight of the squared heights of standing feet [1/cm^2] over one ground, on which several people before
            one camera start, too; 0 leaves it out.
        sliding: Weight of the squared speeds of feet that stand [1/(0.1 m/s)^2], where moves are smooth in time; 0
            leaves it out.
        one_size: Give everybody whom one camera sees in many frames the most probable size for all of them; else sizes
            are the mean of frames, which lies nearer to the mean person.
        stature: Height of the one person, standing [m], before one camera, which then guesses no size. Several cameras
            see how large people are.
        exchanges: Exchange people of a picture in depth where labels ask for it; else the order is the start's, but
            for a z gradient (``mesh.gradient``).
        together: Side of the crop in which people who overlap are drawn together [px].
        window: Frames of a film that are fitted together.
        overlap: Frames that two windows share, from one to the other.
        shape_frames: Frames, spread over a film of several windows, in which a person's shape is found.
        landmarks: Network whose keypoints `partdr fit` and `partdr scene` take of a film's people
            (``find_film_people``).
    """

    mesh: MeshOptions = field(default_factory=MeshOptions)
    smoothing: float = 0.15
    apart: float = 0.1
    ground: float = 0.1
    sliding: float = 0.3
    one_size: bool = True
    stature: float | None = None
    exchanges: bool = True
    together: int = 256
    window: int = 128
    overlap: int = 12
    shape_frames: int = 16
    landmarks: LandmarkNetwork = "heavy"

    def __post_init__(self) -> None:
        if not 0 <= self.smoothing < math.inf:
            raise ValueError(f"smoothing: {self.smoothing}; expected seconds, 0 or more")
        for name in ("apart", "ground", "sliding"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name}: {getattr(self, name)}; expected 0 or a positive number")
        object.__setattr__(self, "stature", check_stature(self.stature))
        check_whole("together", self.together, 1, math.isqrt(MAX_PICTURE) - 1)
        check_whole("window", self.window, 1)
        check_whole("overlap", self.overlap, 0, self.window - 1)
        check_whole("shape_frames", self.shape_frames, 1)
        check_landmark_network(self.landmarks)

    def check_sights(self, people: int, cameras: int) -> None:
        """Check that a known stature is of one person before one camera, of so many.

        Raises:
            InputError: If it is not.
        """
        if self.stature is not None and (people, cameras) != (1, 1):
            told = f"stature: {self.stature:g} m, of {people} people before {cameras} cameras"
            raise InputError(f"{told}; expected one person before one camera")

    @classmethod
    def film(cls) -> SceneOptions:
        """Options of films: moves that are smooth in time are small, so each step is larger.

        The network's errors last many frames, so depth and turns are held less hard than its spreads ask in each. No
        ground: each window would find its own.
        """
        return cls(mesh=MeshOptions(learning_rate=0.02, depth=0.5, turns=2.0), ground=0.0)
