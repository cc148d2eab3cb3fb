"""Options for the fit of a scene."""

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
    """Options for the fit of a scene.

    Attributes:
        mesh: Options for the mesh of each person and for the steps.
        smoothing: Standard deviation of the Gaussian that makes all motion away from the start smooth in time [s].
            Starts are smoothed with two thirds of it. 0 fits each frame on its own.
        apart: Weight ``MeshOptions.apart`` for scenes of several people. It keeps people out of one another, as it
            keeps a person's own parts.
        ground: Weight of the squared heights of standing feet above one ground [1/cm^2]. Several people in front of one
            camera start on this ground, too. 0 uses no ground.
        sliding: Weight of the squared speeds of standing feet [1/(0.1 m/s)^2], if motion is smooth in time. 0 lets feet
            slide.
        one_size: Switch for people whom one camera observes in many frames. If it is True, they get the most probable
            size. If it is False, they get the mean over the frames, which is nearer to the mean person.
        stature: Height of the only person, standing [m], in front of only one camera. The fit then guesses no size.
            Several cameras show how large people are.
        exchanges: Switch for exchanges of people in depth where labels ask for them. If it is False, people keep the
            order of the start, unless there is a z gradient (``mesh.gradient``).
        together: Side of the crop in which people who overlap are drawn together [px].
        window: Number of frames of a film that are fitted at once.
        overlap: Number of frames that a window shares with the next one.
        shape_frames: Number of frames, spread over a film with several windows, from which a person's shape is found.
        landmarks: Network whose keypoints of a film's people `partdr fit` and `partdr scene` take
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

    def check_known_stature(self, people: int, cameras: int) -> None:
        """Checks that a known stature is used for one person in front of one camera.

        Raises:
            InputError: If there are more people or cameras.
        """
        if self.stature is not None and (people, cameras) != (1, 1):
            raise InputError(
                f"stature: {self.stature:g} m, for {people} people and {cameras} cameras; expected one person in front "
                "of one camera"
            )

    @classmethod
    def film(cls) -> SceneOptions:
        """Options for films.

        Motion that is smooth in time changes little in a step, so steps are larger. The network's errors last for many
        frames, so depths and rotations are held less firmly than its uncertainty in a single frame asks. There is no
        ground, because each window would find its own.
        """
        return cls(mesh=MeshOptions(learning_rate=0.02, depth=0.5, turns=2.0), ground=0.0)
