"""Options of a fit: its stages, weights and start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from ...body.labels import LabelSet
from ...body.pose_prior import PosePrior
from ...body.stature import check_stature
from ...inputs.observations import Observations
from ...inputs.part_labels import PartLabels
from ...networks.detection import LandmarkNetwork, check_landmark_network
from ...render.renderers import Renderer, RendererEllipsoids
from ..mesh.mesh_options import MeshOptions
from .energy import Energy, Weights
from .stages import LABELS_FIRST_STAGE, OUTLINE, OUTLINE_STAGES, STAGES, Quality, Stage, Start


@dataclass(frozen=True)
class FitOptions:
    """Options of a fit.

    Attributes:
        stages: Stages in order. The first one of a search lifts its hypotheses into 3D. A network's body goes through
            all of them, and stays as it is if there are none.
        weights: Weights of the energy's terms, for stages that have none of their own.
        trust_background: Believe background where confident keypoints say that a limb is; else it is ignored there.
        seed: Seed of the random choice of hypotheses, if there are too many.
        start: Start of the fit: "network" takes the label network's body, "search" takes many hypotheses.
        network: File of a label network of `partdr train`; None takes the packaged one.
        search: Stages of the search that is tried too where the network's body ends far from keypoints or labels; the
            lower energy wins. Empty: never.
        depth_flips: Try the network's body with limbs mirrored in depth, where parts overlap (``repair_depth_orders``).
        guess_camera: True to assume a usual lens (``UsualLens``) if no camera is known, and labels or
            ``Keypoints2D.image_size`` tell the picture's size. Otherwise the camera is one of weak perspective. If
            part labels show that the person is much farther away, a longer lens is assumed (``with_longer_lens``).
        stature: The person's height, standing [m], which the body then has; one picture does not tell sizes. None: the
            network's guess. Of one person (``fit_body``, ``fit_photo``).
        mirror: Ask the network about the mirror image, too; without, it is asked in half the time.
        half: Ask it in bfloat16.
        landmarks: Network whose keypoints are taken where people are found in a photo (``find_people``).
        mesh: Options of the mesh stage, which follows in `partdr fit` and ``fit_photo``.

    Examples:
        >>> from dataclasses import replace
        >>> from warp_partdr import FitOptions
        >>> options = replace(FitOptions.at("accurate"), trust_background=True)
        >>> [(stage.name, stage.iterations) for stage in options.stages]
        [('labels', 50)]
    """

    stages: tuple[Stage, ...] = STAGES["network"]["balanced"]
    weights: Weights = field(default_factory=Weights)
    trust_background: bool = False
    seed: int = 0
    start: Start = "network"
    network: str | None = None
    search: tuple[Stage, ...] = STAGES["search"]["balanced"]
    depth_flips: bool = True
    guess_camera: bool = True
    stature: float | None = None
    mirror: bool = True
    half: bool = False
    landmarks: LandmarkNetwork = "heavy"
    mesh: MeshOptions = field(default_factory=MeshOptions)

    def __post_init__(self) -> None:
        if self.start not in STAGES:
            raise ValueError(f"start: {self.start!r}; expected {', '.join(STAGES)}")
        object.__setattr__(self, "stature", check_stature(self.stature))
        check_landmark_network(self.landmarks)

    @classmethod
    def at(cls, quality: Quality, start: Start = "network") -> FitOptions:
        """Options of a quality: "fast", "balanced" (the default) or "accurate"; ``replace`` changes any of them.

        Raises:
            ValueError: If there is no such quality or start.

        Examples:
            >>> from warp_partdr import FitOptions
            >>> [stage.name for stage in FitOptions.at("fast", start="search").stages]
            ['lift', 'keypoints', 'labels, coarse', 'labels, fine']
        """
        if start not in STAGES:
            raise ValueError(f"start: {start!r}; expected {', '.join(STAGES)}")
        if quality not in STAGES[start]:
            raise ValueError(f"quality: {quality!r}; expected {', '.join(STAGES[start])}")
        stages, search = STAGES[start][quality], STAGES["search"][quality]
        landmarks: LandmarkNetwork = "full" if quality == "fast" else "heavy"
        return cls(stages=stages, start=start, search=search, landmarks=landmarks, mesh=MeshOptions.at(quality))

    def drawn_by(self, change: Callable[[Renderer], Renderer]) -> FitOptions:
        """Options whose stages, also of the search, have renderers that ``change`` makes of theirs.

        ``options.drawn_by(lambda old: RendererMesh(1, max_distance=old.max_distance))`` draws the paper's mesh.
        """

        def changed(stages: tuple[Stage, ...]) -> tuple[Stage, ...]:
            return tuple(replace(stage, renderer=change(stage.renderer)) for stage in stages)

        return replace(self, stages=changed(self.stages), search=changed(self.search))

    @property
    def renderer(self) -> Renderer:
        """Renderer of the last stage; exact ellipsoids where there is none."""
        return self.stages[-1].renderer if self.stages else RendererEllipsoids()

    def energy(self, stage: Stage, observations: Observations, prior: PosePrior) -> Energy:
        """Energy of N people in one of the stages."""
        weights = stage.weights or self.weights
        if stage.size == 0:
            weights = replace(weights, seg=0.0)
        return Energy(observations, max(stage.size, 1), weights, prior, renderer=stage.renderer)

    def with_outline(self, *, labels_first: bool = False) -> FitOptions:
        """Add a last stage that follows the outlines of part labels, also to the search.

        Outlines come nearer to the labels, and joints go farther from the truth. A detailed body follows outlines
        without that cost, so that fits which a mesh stage goes on from (``refine_mesh``) should not have this stage.

        Args:
            labels_first: Follow the outlines as far as ellipsoids can, whatever it costs the joints.

        Example:
            >>> [stage.name for stage in FitOptions.at("fast").with_outline().stages]
            ['labels', 'outline']

        Examples:
            After ``parts = read_parts("parts.png", "cdcl14")`` and ``person = read_keypoints("keypoints.json")[0]``:

            >>> from warp_partdr import FitOptions, fit_body
            >>> options = FitOptions.at("fast").with_outline()
            >>> [stage.name for stage in fit_body(person, parts, options=options).stages]
            ['labels', 'outline']
        """
        last = LABELS_FIRST_STAGE if labels_first else OUTLINE_STAGES[self.start]
        search = (*self.search, OUTLINE_STAGES["search"]) if self.search else ()
        return replace(self, stages=(*self.stages, last), search=search)


def stages_of(options: FitOptions, parts: PartLabels | LabelSet | None) -> tuple[Stage, ...]:
    """Stages of a fit; without labels, nothing is drawn, and a network's body follows the keypoints alone.

    Raises:
        ValueError: If a search has none left.
    """
    if options.start == "network":
        if parts is not None:
            return options.stages
        return tuple(replace(stage, size=0) for stage in options.stages if stage.name != OUTLINE)
    stages = drawn_or_not(options.stages, parts)
    if not stages:
        raise ValueError("options.stages: none without labels; expected at least one of size 0")
    return stages


def drawn_or_not(stages: tuple[Stage, ...], parts: PartLabels | LabelSet | None) -> tuple[Stage, ...]:
    """Leave out the stages that draw if there are no labels."""
    return tuple(stage for stage in stages if parts is not None or stage.size == 0)
