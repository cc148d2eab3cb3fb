"""From one person's 2D keypoints and part labels to a body: many hypotheses, side by side, pruned as they go."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch

from .body.ellipbody import DEFAULT_SUBDIVISIONS
from .body.movable import Movable
from .body.template import NUM_PARTS
from .cameras import Crop, WeakPerspective
from .energy import REFERENCE_SIZE, Energy, LandmarkGather, Observation, Renderer, Weights
from .errors import check_type
from .evidence import Evidence, weigh_evidence
from .fused import minimise
from .hypotheses import LiftEnergy, distinct, hypothesize
from .keypoints import Keypoints2D
from .mesh import ellipbody_mesh
from .network.checkpoint import load_label_network, packaged_network
from .network.predict import predict_bodies
from .observation import crop_evidence
from .parameters import BodyParameters
from .part_files import PartLabels
from .plausibility import complaints, poor_labels
from .pose_prior import PosePrior
from .posing import Posed
from .quality import OUTLINE, STAGES, Quality, Stage, Start
from .refinement import refine
from .render import DEFAULT_DEPTH_WEIGHT, PartImage, rasterize_parts
from .sides import choose_sides
from .subdivisions import DEFAULT_TOLERANCE, Subdivisions, coarsest_subdivisions
from .torch_threads import one_torch_thread

Progress = Callable[[str, int, int], None]


_LABELS_FIRST = Stage(OUTLINE, 1, 1000, 0.01, 256, Weights(seg=1.0), gradient="coverage")


@dataclass(frozen=True)
class FitOptions:
    """How a fit goes.

    Attributes:
        stages: In order. The first one of a search lifts its hypotheses into 3D; a network's body goes through all of
            them, and stays as it is where there are none.
        weights: Of the energy's terms, where a stage has none of its own.
        renderer: "exact" ellipsoids, or their "mesh", with PartDR's gradient.
        subdivisions: Level of the mesh, 0 to 3; "auto": in each stage the coarsest that is within ``tolerance`` of the
            ellipsoids.
        tolerance: Of "auto" [px of the drawn crop].
        trust_background: Believe background where confident keypoints say that a limb is; else it is ignored there.
        depth_weight: The paper's lambda of PartDR's z gradient; 0 leaves it out.
        seed: Of the random choice of hypotheses, where there are too many.
        start: "network": the label network's body; "search": many hypotheses.
        network: File of a label network of `partdr train`; None takes the packaged one.
        search: Stages of the search that is tried too where the network's body ends far from keypoints or labels; the
            lower energy wins. Empty: never.
    """

    stages: tuple[Stage, ...] = STAGES["network"]["balanced"]
    weights: Weights = field(default_factory=Weights)
    renderer: Renderer = "exact"
    subdivisions: Subdivisions = DEFAULT_SUBDIVISIONS
    tolerance: float = DEFAULT_TOLERANCE
    trust_background: bool = False
    depth_weight: float = DEFAULT_DEPTH_WEIGHT
    seed: int = 0
    start: Start = "network"
    network: str | None = None
    search: tuple[Stage, ...] = STAGES["search"]["balanced"]

    def __post_init__(self) -> None:
        if self.start not in STAGES:
            raise ValueError(f"start: {self.start!r}; expected {', '.join(STAGES)}")

    @classmethod
    def at(cls, quality: Quality, start: Start = "network") -> FitOptions:
        """Those of a quality: "fast", "balanced" (the default) or "accurate"; ``replace`` changes any of them.

        Raises:
            ValueError: If there is no such quality or start.
        """
        if start not in STAGES:
            raise ValueError(f"start: {start!r}; expected {', '.join(STAGES)}")
        if quality not in STAGES[start]:
            raise ValueError(f"quality: {quality!r}; expected {', '.join(STAGES[start])}")
        return cls(stages=STAGES[start][quality], start=start, search=STAGES["search"][quality])

    def labels_first(self) -> FitOptions:
        """The same, but its last stage follows the labels' outlines as far as it can, and joints pay for it.

        With the coverage gradient, whose steps lower the loss, and the default weights but for L_seg's, which is 1.
        """
        return replace(self, stages=(*self.without_outline().stages, _LABELS_FIRST))

    def without_outline(self) -> FitOptions:
        """The same but for the last stage: joints nearer to the truth, outlines farther from the labels."""
        return replace(self, stages=tuple(stage for stage in self.stages if stage.name != OUTLINE))


@dataclass(frozen=True)
class FitResult(Movable):
    """A fitted body.

    Attributes:
        parameters: The body and its camera in the crop, B = 1.
        crop: Where the crop lies in the picture.
        observation: What was fitted, in the crop.
        stages: The rounds it took.
        energy: Weighted terms of the energy at the end, by name.
        history: Energy of the winner's lineage before each iteration, one row a stage.
        stage_seconds: Wall time of each stage.
        hypotheses: How many starts there were.
        finalists: Energies at the end of the last stage that compared several bodies, best first.
        start: Where the winner comes from, "network" or "search".
        evidence: Keypoints and labels that it went by.
        warnings: What looks wrong, in the input or at the end, a sentence each.
    """

    parameters: BodyParameters
    crop: Crop
    observation: Observation
    stages: tuple[Stage, ...]
    energy: dict[str, float]
    history: list[np.ndarray]
    stage_seconds: dict[str, float]
    hypotheses: int
    finalists: list[float]
    start: Start
    evidence: Evidence
    warnings: tuple[str, ...] = ()

    @property
    def camera(self) -> WeakPerspective:
        """The camera in pixels of the full picture."""
        return self.parameters.camera(self.crop.size[0]).in_full(self.crop)

    @property
    def posed(self) -> Posed:
        """The body in the camera frame, pelvis at the origin [m]."""
        return self.parameters.posed()

    def landmarks(self, names: Sequence[str]) -> np.ndarray:
        """Landmarks (see ``body.landmarks``) in the camera frame, shape (L, 3) [m]."""
        return LandmarkGather(names, self.parameters.shift.device)(self.posed)[0].cpu().numpy()

    def draw(
        self,
        image_size: tuple[int, int],
        *,
        subdivisions: Subdivisions = 3,
        tolerance: float = DEFAULT_TOLERANCE,
        camera: WeakPerspective | None = None,
    ) -> PartImage:
        """The body's 20 parts in the full picture, or in another camera's.

        Args:
            image_size: (H, W) [px].
            subdivisions: Level of the mesh, 0 to 3, or "auto": the coarsest that keeps the tolerance.
            tolerance: How far its silhouettes may be from the ellipsoids' [px].
            camera: Instead of the fit's.

        Raises:
            ValueError: If no level keeps the tolerance.
        """
        camera = camera or self.camera
        if subdivisions == "auto":
            subdivisions = coarsest_subdivisions(self.posed, camera, tolerance=tolerance)
        vertices = camera.project(self.posed.vertices(subdivisions))
        return rasterize_parts(vertices, ellipbody_mesh(subdivisions, device=vertices.device), image_size)


@one_torch_thread()
def fit_body(
    keypoints: Keypoints2D,
    parts: PartLabels | None = None,
    *,
    others: Sequence[Keypoints2D] = (),
    quality: Quality = "balanced",
    options: FitOptions | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
) -> FitResult:
    """Fit EllipBody to one person.

    What contradicts itself is mended where it is clear, and told in ``warnings``: left and right that differ between
    labels and keypoints are exchanged in the one that seems wrong, and blobs of labels far from any bone are ignored.

    Args:
        keypoints: The person's 2D keypoints in the picture.
        parts: The picture's part labels; None fits keypoints alone.
        others: Other people's keypoints, which keep their labels apart from the person's.
        quality: "fast", "balanced" or "accurate": stages and picture sizes; docs/accuracy.md has what each gives.
        options: Stages, weights and renderer of your own, instead of those of ``quality``.
        device: "cpu" or a CUDA device.
        progress: Called with (stage name, iterations done, iterations in all).

    Returns:
        The body, its camera, and how it went.

    Raises:
        InputError: If no keypoint is visible, all lie in one point, or labels and keypoints do not meet.
        TypeError: If an argument is of another type.
    """
    check_type("options", options, FitOptions | None, "such as FitOptions.at('fast')")
    options = options or FitOptions.at(quality)
    prior = PosePrior().to(device)

    def start(evidence: Evidence, options: FitOptions, progress: Progress | None = None) -> _Fit:
        seen, crop = crop_evidence(evidence, trust_background=options.trust_background, device=device)
        return _Fit(seen, crop, prior, options, stages_of(options, parts), evidence, progress)

    def glance(evidence: Evidence) -> FitResult:
        return start(evidence, replace(options, stages=STAGES["network"]["fast"], start="network")).from_network()

    evidence = choose_sides(weigh_evidence(keypoints, parts, others), glance)
    fit = start(evidence, options, progress)
    if options.start == "search":
        found = fit.search()
        return fit.warn(found, fit.complaints(found))
    found = fit.from_network()
    told = fit.complaints(found)
    if told and options.search:
        stages = _drawn_or_not(options.search, parts)
        found = fit.better(found, replace(fit, stages=stages).search())
        told = fit.complaints(found)
    return fit.warn(found, told)


@dataclass(frozen=True)
class _Fit:
    """A fit of one observation; arguments as ``fit_body`` has them."""

    seen: Observation
    crop: Crop
    prior: PosePrior
    options: FitOptions
    stages: tuple[Stage, ...]
    evidence: Evidence
    progress: Progress | None

    def search(self) -> FitResult:
        """From many hypotheses, lifted in the first stage."""
        first = self.stages[0]
        bodies, targets, known = hypothesize(self.seen, first.bodies, seed=self.options.seed)
        bodies = replace(bodies, rotations=self.prior.mean_pose.expand(bodies.batch_size, NUM_PARTS, 3))
        return self._refine(bodies, self.seen, "search", lambda energy: LiftEnergy(energy, targets, known))

    def from_network(self) -> FitResult:
        """From the network's body, whose sizes are what is expected of the person from then on."""
        device, path = self.seen.points.device, self.options.network
        network = packaged_network(str(device)) if path is None else load_label_network(path, device=device)
        started = time.perf_counter()
        body = predict_bodies([self.seen], network)
        seconds = time.perf_counter() - started
        seen = replace(self.seen, lengths=body.lengths[0], thicknesses=body.thicknesses[0])
        found = self._refine(body, seen, "network")
        return replace(found, stage_seconds={"network": seconds, **found.stage_seconds})

    def _refine(
        self,
        bodies: BodyParameters,
        seen: Observation,
        start: Start,
        lift: Callable[[Energy], LiftEnergy] | None = None,
    ) -> FitResult:
        """All stages; the first one by another energy, if there is one."""
        options, hypotheses = self.options, bodies.batch_size
        energies = torch.zeros(hypotheses, device=seen.points.device)
        terms: dict[str, torch.Tensor] = {}
        seconds: dict[str, float] = {}
        lineage: list[np.ndarray] = []  # energies of what is left and of its ancestors
        finalists: list[float] = []
        done, total = 0, sum(stage.iterations for stage in self.stages)
        for index, stage in enumerate(self.stages):
            started = time.perf_counter()
            if len(energies) > 1 and index > 0:
                kept = distinct(bodies, energies, stage.bodies)
                bodies = bodies.select(kept)
                lineage = [rows[:, kept.cpu().numpy()] for rows in lineage]
            weights = stage.weights or options.weights
            if stage.size == 0:
                weights = replace(weights, seg=0.0)
            if weights.depth > 0 and (count := len(bodies.log_scale)) > 1:
                raise ValueError(f"stages: {stage.name!r} holds depth, of {count} bodies; expected one body")
            energy = Energy(
                seen,
                max(stage.size, 1),
                weights,
                self.prior,
                renderer=options.renderer,
                subdivisions=options.subdivisions,
                tolerance=options.tolerance,
                gradient=stage.gradient,
                max_distance=stage.max_distance,
                depth_weight=options.depth_weight,
                depths=bodies.posed().centres[0, :, 2] if weights.depth > 0 else None,
            )

            def step(iteration: int, name: str = stage.name, before: int = done) -> None:
                if self.progress is not None:
                    self.progress(name, before + iteration, total)

            pace: dict[str, Any] = {
                "iterations": stage.iterations,
                "learning_rate": stage.learning_rate,
                "frozen": stage.frozen,
                "on_iteration": step,
            }
            if lift is not None and index == 0:
                refined = refine(bodies, lift(energy), **pace)
            else:
                refined = minimise(bodies, energy, **pace)
            bodies, energies, terms = refined.parameters, refined.energy, refined.terms
            lineage.append(refined.history.cpu().numpy())
            if len(energies) > 1:
                finalists = energies.sort().values.tolist()
            done += stage.iterations
            seconds[stage.name] = time.perf_counter() - started
        winner = int(energies.argmin())
        return FitResult(
            parameters=bodies.select(torch.tensor([winner], device=energies.device)),
            crop=self.crop,
            observation=seen,
            stages=self.stages,
            energy={name: float(term[winner]) for name, term in terms.items()},
            history=[rows[:, winner] for rows in lineage],
            stage_seconds=seconds,
            hypotheses=hypotheses,
            finalists=finalists,
            start=start,
            evidence=self.evidence,
        )

    def complaints(self, found: FitResult) -> list[str]:
        """Sentences about what the body is too far from; none if it lies where keypoints and labels are."""
        return complaints(found.parameters, self._judge())

    def warn(self, found: FitResult, told: Sequence[str]) -> FitResult:
        """The same, with all that looks wrong: in what was given, what was told of the body, and its parts."""
        poor = poor_labels(found.parameters, self._judge())
        return replace(found, warnings=(*self.evidence.warnings, *told, *poor))

    def better(self, found: FitResult, again: FitResult) -> FitResult:
        """The one with the lower energy; times and hypotheses are both's."""
        energy = self._judge()
        losses = [sum(float(term) for term in energy(result.parameters).values()) for result in (found, again)]
        seconds = {
            f"{name}, {each.start}": value for each in (found, again) for name, value in each.stage_seconds.items()
        }
        best = again if losses[1] < losses[0] else found
        return replace(best, stage_seconds=seconds, hypotheses=found.hypotheses + again.hypotheses)

    def _judge(self) -> Energy:
        """The same for all starts."""
        options = self.options
        return Energy(
            self.seen,
            REFERENCE_SIZE,
            options.weights,
            self.prior,
            renderer=options.renderer,
            subdivisions=options.subdivisions,
        )


def stages_of(options: FitOptions, parts: PartLabels | None) -> tuple[Stage, ...]:
    """The rounds of a fit: without labels, nothing is drawn, and a network's body follows the keypoints alone.

    Raises:
        ValueError: If a search has none left.
    """
    if options.start == "network":
        if parts is not None:
            return options.stages
        return tuple(replace(stage, size=0) for stage in options.stages if stage.name != OUTLINE)
    stages = _drawn_or_not(options.stages, parts)
    if not stages:
        raise ValueError("options.stages: none without labels; expected at least one of size 0")
    return stages


def _drawn_or_not(stages: tuple[Stage, ...], parts: PartLabels | None) -> tuple[Stage, ...]:
    return tuple(stage for stage in stages if parts is not None or stage.size == 0)
