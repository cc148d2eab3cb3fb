"""Fit of EllipBody to one person's 2D keypoints and part labels: hypotheses are refined in a batch and pruned."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import torch

from ...body.lens import turn_to_rays
from ...body.parameters import BodyParameters
from ...body.pose_prior import PosePrior, packaged_prior
from ...body.stature import bone_statures
from ...body.template import NUM_PARTS
from ...cameras import Crop, Perspective, check_square
from ...errors import check_type
from ...inputs.evidence import Evidence, weigh_evidence
from ...inputs.keypoints import Keypoints2D
from ...inputs.observation import Observation, crop_evidence, usual_lens
from ...inputs.part_labels import PartLabels
from ...inputs.person import check_inside
from ...interop.gradient_mode import with_gradients
from ...interop.torch_threads import one_torch_thread
from ...networks.regression.checkpoint import known_network
from ...networks.regression.label_network import LabelNetwork
from ...networks.regression.predict import ask_network
from ...networks.regression.predicted import Predicted
from .depth_flips import repair_depth_order
from .energy import Energy
from .far_people import shows_parts, with_longer_lens
from .options import FitOptions, drawn_or_not, stages_of
from .plausibility import choose_sides, complaints, poor_labels
from .refine import refine
from .result import FitResult
from .stages import OUTLINE, STAGES, Quality, Stage, Start
from .start_search import LiftEnergy, distinct, hypothesize
from .wrong_keypoints import doubt_keypoints

Progress = Callable[[str, int, int], None]
Sized = TypeVar("Sized", BodyParameters, Predicted)


@one_torch_thread()
@with_gradients()
def fit_body(
    keypoints: Keypoints2D,
    parts: PartLabels | None = None,
    *,
    others: Sequence[Keypoints2D] = (),
    quality: Quality = "balanced",
    options: FitOptions | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
    camera: Perspective | None = None,
) -> FitResult:
    """Fit EllipBody to one person.

    Clear contradictions of the input are mended, and reported in ``warnings``: left and right that differ between
    labels and keypoints are exchanged in the one that seems wrong, and blobs of labels far from any bone are ignored.

    Args:
        keypoints: The person's 2D keypoints in the picture.
        parts: The picture's part labels; None fits keypoints alone.
        others: Other people's keypoints, which keep their labels apart from the person's.
        quality: "fast", "balanced" or "accurate": stages and picture sizes; docs/accuracy.md has what each gives.
        options: Stages and weights of your own, instead of those of ``quality``.
        device: "cpu" or a CUDA device.
        progress: Called with (stage name, iterations done, iterations in all).
        camera: The picture's, such as ``Perspective.of_picture(size, focal=1500)``, with square pixels: the body then
            stands where it is seen, in metres from the camera. None: a usual lens (``FitOptions.guess_camera``), or a
            longer one where part labels show that the person is far away. Where neither labels nor
            ``keypoints.image_size`` tell the picture's size, that is weak perspective.

    Returns:
        The body, its camera, and how it went.

    Raises:
        InputError: If no keypoint is visible, all lie in one point, none lies in a picture of ``image_size``, or labels
            and keypoints do not meet.
        TypeError: If an argument is of another type.
        ValueError: If there is not one camera with square pixels.
    """
    check_type("options", options, FitOptions | None, "such as FitOptions.at('fast')")
    options = options or FitOptions.at(quality)
    readings = weigh_evidence(keypoints, parts, others)
    if parts is None and keypoints.image_size is not None:
        check_inside(keypoints, keypoints.image_size)
    return fit_evidence(readings, options, device=device, progress=progress, camera=camera)


@one_torch_thread()
@with_gradients()
def fit_evidence(
    readings: Sequence[Evidence],
    options: FitOptions,
    *,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
    camera: Perspective | None = None,
    body: BodyParameters | None = None,
) -> FitResult:
    """Fit EllipBody to a person whose evidence was weighed (``weigh_evidence``); the rest is as of ``fit_body``.

    From ``body``, in the crop of ``crop_evidence``, instead of the network's, of which only its uncertainty is used.
    """
    _check_camera(camera)
    assumed = camera is None and options.guess_camera and body is None
    if assumed:
        camera = usual_lens(readings[0])
    prior, parts = packaged_prior(str(device)), readings[0].picture

    def start(evidence: Evidence, options: FitOptions, progress: Progress | None = None) -> _Fit:
        trust = options.trust_background
        seen, crop = crop_evidence(evidence, trust_background=trust, device=device, camera=camera)
        return _Fit(seen, crop, prior, options, stages_of(options, parts), evidence, progress, body, assumed)

    def glance(evidence: Evidence) -> FitResult:
        fit = start(evidence, replace(options, stages=STAGES["network"]["fast"], start="network"))
        return fit.looked_at().from_network(doubt=False)  # or a wrong reading would seem to fit

    evidence = choose_sides(readings, glance)
    plain, from_network = start(evidence, options, progress), options.start == "network"
    fit = plain.looked_at() if from_network else plain
    found = fit.from_network() if from_network else fit.search()
    # Far from keypoints that the network itself doubts, its body may be right: a search would follow them.
    if from_network and options.search and fit.complaints(found, found.observation):
        fit, found = fit.better(found, replace(fit, stages=drawn_or_not(options.search, parts)))
    return fit.warn(found)


@dataclass(frozen=True)
class _Fit:
    """Fit of one observation; arguments as ``fit_body`` has them."""

    seen: Observation
    crop: Crop
    prior: PosePrior
    options: FitOptions
    stages: tuple[Stage, ...]
    evidence: Evidence
    progress: Progress | None
    body: BodyParameters | None
    own_lens: bool  # True if the lens is assumed for this person alone, and not for everybody in the picture
    predicted: Predicted | None = None  # by the network, of ``looked_at``
    seconds: float = 0.0  # that the network took

    def search(self) -> FitResult:
        """Fit from many hypotheses, lifted in the first stage."""
        first = self.stages[0]
        bodies, targets, known = hypothesize(self.seen, first.bodies, seed=self.options.seed)
        bodies = replace(bodies, rotations=self.prior.mean_pose.expand(bodies.batch_size, NUM_PARTS, 3))
        bodies, seen = self._sized(self._turned(bodies)), self.seen
        if self.options.stature is not None:
            seen = replace(seen, lengths=bodies.lengths[0], thicknesses=bodies.thicknesses[0])
        return self._refine(bodies, seen, "search", lambda energy: LiftEnergy(energy, targets, known))

    def _sized(self, bodies: Sized) -> Sized:
        """Bodies as tall as the person is known to be; cameras see the same."""
        stature = self.options.stature
        return bodies if stature is None else bodies.resized(stature / bone_statures(bodies.lengths))

    def _turned(self, bodies: BodyParameters) -> BodyParameters:
        """Starts, which are made as if the camera looked at the person, before the camera that is known."""
        return bodies if self.seen.lens is None else turn_to_rays(bodies, self.seen.lens)

    def looked_at(self) -> _Fit:
        """Returns a copy with the network's prediction, and with a longer lens for a person who is far away."""
        network = known_network(self.options.network, str(self.seen.points.device))
        started = time.perf_counter()
        fit, predicted = self, self._ask(network)
        longer = with_longer_lens(self.seen, predicted) if self.own_lens else None
        if longer is not None:
            fit = replace(self, seen=longer)
            predicted = fit._ask(network)
        return replace(fit, predicted=predicted, seconds=time.perf_counter() - started)

    def _ask(self, network: LabelNetwork) -> Predicted:
        told = replace(self.seen, stature=self.options.stature)
        return self._sized(ask_network([told], network, mirror=self.options.mirror, half=self.options.half))

    def from_network(self, *, doubt: bool = True) -> FitResult:
        """Fit from the body of ``looked_at``, whose sizes then are the expected ones.

        With ``doubt``, keypoints far from that body count less (``doubt_keypoints``).
        """
        predicted = self.predicted
        assert predicted is not None
        body = self._turned(predicted.parameters()) if self.body is None else self._sized(self.body)
        seconds = {"network": self.seconds}
        seen = doubt_keypoints(self.seen, predicted) if doubt else self.seen
        seen = replace(seen, lengths=body.lengths[0], thicknesses=body.thicknesses[0])
        said, order = predicted.uncertainty, None
        assert said is not None
        several = shows_parts(seen)  # within one part, nothing hides another
        if self.stages and several and self.options.depth_flips:
            started = time.perf_counter()
            # What the network says of its own body it does not say of others.
            body, order = repair_depth_order(body, seen, self.prior, said if self.body is None else None)
            seconds["depth order"] = time.perf_counter() - started
        seen = replace(seen, depths=body.posed().centres[0, :, 2], depth_spreads=said.centre_depths()[0])
        found = self._refine(body, seen, "network")
        return replace(
            found,
            stage_seconds=seconds | found.stage_seconds,
            depth_order=order,
            uncertainty=said,
        )

    def _refine(
        self,
        bodies: BodyParameters,
        seen: Observation,
        start: Start,
        lift: Callable[[Energy], LiftEnergy] | None = None,
    ) -> FitResult:
        """Refine through all stages; the first one by another energy, if there is one."""
        hypotheses = bodies.batch_size
        energies = torch.zeros(hypotheses, device=seen.points.device)
        terms: dict[str, torch.Tensor] = {}
        seconds: dict[str, float] = {}
        lineage: list[np.ndarray] = []  # energies of what is left and of its ancestors
        finalists: list[float] = []
        before_outline: BodyParameters | None = None
        done, total = 0, sum(stage.iterations for stage in self.stages)
        for index, stage in enumerate(self.stages):
            started = time.perf_counter()
            if len(energies) > 1 and index > 0:
                kept = distinct(bodies, energies, stage.bodies)
                bodies = bodies.select(kept)
                lineage = [rows[:, kept.cpu().numpy()] for rows in lineage]
            if stage.name == OUTLINE:
                before_outline = bodies
            energy = self.options.energy(stage, seen, self.prior)

            def step(iteration: int, name: str = stage.name, before: int = done) -> None:
                if self.progress is not None:
                    self.progress(name, before + iteration, total)

            refined = refine(
                bodies,
                lift(energy) if lift is not None and index == 0 else energy,
                iterations=stage.iterations,
                learning_rate=stage.learning_rate,
                frozen=stage.frozen,
                on_iteration=step,
            )
            bodies, energies, terms = refined.parameters, refined.energy, refined.terms
            lineage.append(refined.history.cpu().numpy())
            if len(energies) > 1:
                finalists = energies.sort().values.tolist()
            done += stage.iterations
            seconds[stage.name] = time.perf_counter() - started
        winner = int(energies.argmin())
        chosen = torch.tensor([winner], device=energies.device)
        return FitResult(
            parameters=self._sized(bodies.select(chosen)),
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
            before_outline=None if before_outline is None else self._sized(before_outline.select(chosen)),
            stature=self.options.stature,
        )

    def complaints(self, found: FitResult, seen: Observation) -> list[str]:
        """Warnings of what the body is too far from; none if it lies where keypoints and labels are."""
        return complaints(found.parameters, self._judge(seen), self.evidence.keypoints.format)

    def warn(self, found: FitResult) -> FitResult:
        """Result with all warnings: of the input, of the body and of its parts. All keypoints count as they are."""
        poor = poor_labels(found.parameters, self._judge(self.seen))
        return replace(found, warnings=(*self.evidence.warnings, *self.complaints(found, self.seen), *poor))

    def better(self, found: FitResult, other: _Fit) -> tuple[_Fit, FitResult]:
        """The fit whose result has the lower energy, this one's or the other's search; with times of both."""
        again = other.search()
        losses = [
            sum(float(term) for term in self._judge(self.seen)(result.parameters).values()) for result in (found, again)
        ]
        seconds = {
            f"{name}, {each.start}": value for each in (found, again) for name, value in each.stage_seconds.items()
        }
        fit, best = (other, again) if losses[1] < losses[0] else (self, found)
        return fit, replace(best, stage_seconds=seconds, hypotheses=found.hypotheses + again.hypotheses)

    def _judge(self, seen: Observation) -> Energy:
        """Energy by which results of all starts are compared."""
        return Energy(seen, weights=self.options.weights, prior=self.prior, renderer=self.options.renderer)


def _check_camera(camera: Perspective | None) -> None:
    check_type("camera", camera, Perspective | None, "such as Perspective.of_picture(size, focal=1500)")
    if camera is not None:
        check_square(camera)
