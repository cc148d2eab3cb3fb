"""Fit of EllipBody to people's 2D keypoints and part labels, side by side; one person is a batch of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from ...body.parameters import BodyParameters
from ...body.pose_prior import PosePrior, packaged_prior
from ...body.skeletons import skeleton
from ...body.template import NUM_PARTS
from ...cameras import Perspective, check_square
from ...errors import check_each, check_type
from ...inputs.cut_people import CutPeople, CutPerson, batch_people
from ...inputs.evidence import Evidence, weigh_evidence
from ...inputs.keypoints import Keypoints2D
from ...inputs.observation import crop_evidence, usual_lens
from ...inputs.observations import Observations
from ...inputs.part_labels import PartLabels
from ...inputs.person import check_inside
from ...interop.gradient_mode import with_gradients
from ...interop.torch_threads import one_torch_thread
from ...networks.regression.checkpoint import known_network
from ...networks.regression.label_network import LabelNetwork
from .batch_fits import BatchFits
from .energy import Energy
from .network_start import sized, start_from_network, turned_to_lenses
from .options import FitOptions, drawn_or_not, stages_of
from .plausibility import far_bodies, find_poor_labels, implausibility
from .result import FitResult
from .stage_loop import refine_stages
from .stages import STAGES, Progress, Quality, Stage
from .start_search import LiftEnergy, hypothesize


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
        quality: Quality "fast", "balanced" or "accurate": it chooses stages and picture sizes;
            docs/measured/speed_and_accuracy.md has the accuracy of each.
        options: Stages and weights of your own, instead of those of ``quality``.
        device: Device of the fit, "cpu" or a CUDA device.
        progress: Function that is called with (stage name, iterations done, iterations in all).
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

    Examples:
        >>> from warp_partdr import choose_person, fit_body, read_keypoints, read_parts
        >>> parts = read_parts("parts.png", "cdcl14")
        >>> person = choose_person(read_keypoints("keypoints.json"), parts.groups)
        >>> result = fit_body(person, parts)
        >>> result.posed.joints.shape  # in the camera frame [m]
        torch.Size([1, 21, 3])
        >>> result.landmarks(["nose", "left_wrist"]).shape
        (2, 3)
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
    """Fit EllipBody to a person whose evidence was weighed (``weigh_evidence``).

    Args:
        readings: One reading of the evidence, or two of which the more plausible one is taken.
        options: Stages and weights.
        device: Device of the fit, "cpu" or a CUDA device.
        progress: Function that is called after each iteration, as for ``fit_body``.
        camera: Camera of the picture, as for ``fit_body``.
        body: Body to begin from, B = 1, in the crop of ``crop_evidence``, instead of the network's, of which only its
            uncertainty is used then.
    """
    _check_camera(camera)
    assumed = camera is None and options.guess_camera and body is None
    if assumed:
        camera = usual_lens(readings[0])
    people = []
    for evidence in readings:
        trust = options.trust_background
        observation, crop = crop_evidence(evidence, trust_background=trust, device=device, camera=camera)
        observation = replace(observation, stature=options.stature)
        people.append(CutPerson(evidence, observation, crop))
    network = known_network(options.network, str(device))
    plan = _Plan(options, network, packaged_prior(str(device)), longer_lenses=assumed, bodies=body, progress=progress)
    person = _more_plausible(people, plan)
    return replace(_fit_batch(CutPeople.of([person]), plan)[0], evidence=person.evidence)


@one_torch_thread()
@with_gradients()
def fit_people(people: Sequence[CutPerson], options: FitOptions, network: LabelNetwork) -> Sequence[FitResult]:
    """Fit EllipBody to many people side by side, each as ``fit_body`` alone does, to rounding.

    Args:
        people: People on the network's device. What is known of their cameras and statures stands in their
            observations; a lens that is assumed is lengthened for those who are far away.
        options: Stages and weights, and the search that is tried for people whose bodies end far from keypoints or
            labels. ``options.stature`` and ``options.network`` are not used.
        network: Label network in evaluation mode.

    Returns:
        A fit of each person; ``BatchFits`` of people who are alike where no search was tried. Seconds of stages are
        those of all people who are alike.

    Raises:
        TypeError: If an argument is of another type.
    """
    if not isinstance(people, CutPeople):
        check_each("people", people, CutPerson, "of crop_evidence")
    check_type("options", options, FitOptions, "such as FitOptions.at('fast')")
    check_type("network", network, LabelNetwork, "of load_label_network")
    if isinstance(people, CutPeople):
        device = people.observations.points.device
        return _fit_batch(people, _Plan(options, network, packaged_prior(str(device))))
    groups = batch_people(people)
    if len(groups) == 1:
        return fit_people(groups[0][1], options, network)
    found: dict[int, FitResult] = {}
    for rows, some in groups:
        found |= zip(rows, fit_people(some, options, network), strict=True)
    return [found[row] for row in range(len(people))]


@dataclass(frozen=True)
class _Plan:
    """Way to fit people who are alike.

    Attributes:
        options: Stages and weights.
        network: Label network, on the people's device.
        prior: Prior of poses, on the people's device.
        longer_lenses: Lengthen an assumed lens for a person who is far away. False where one lens is everybody's in a
            picture.
        doubting: Give less confidence to keypoints that the network doubts.
        bodies: Bodies to begin from instead of the network's.
        progress: Called after each iteration.
    """

    options: FitOptions
    network: LabelNetwork
    prior: PosePrior
    longer_lenses: bool = True
    doubting: bool = True
    bodies: BodyParameters | None = None
    progress: Progress | None = None


def _more_plausible(people: Sequence[CutPerson], plan: _Plan) -> CutPerson:
    """Choose the most plausible reading of one person: each is fitted quickly."""
    if len(people) == 1:
        return people[0]
    options = replace(plan.options, stages=STAGES["network"]["fast"], start="network", search=())
    # With doubts, a wrong reading would seem to fit.
    fits = _fit_batch(CutPeople.of(people), replace(plan, options=options, doubting=False, bodies=None, progress=None))
    return people[min(range(len(people)), key=lambda row: implausibility(fits[row]))]


def _fit_batch(people: CutPeople, plan: _Plan) -> Sequence[FitResult]:
    """Fit people who are alike, from the network's bodies or by a search."""
    options, labels = plan.options, people.observations.label_set
    if options.start == "search":
        return _search(people, people.observations, stages_of(options, labels), plan)
    fits, given = _fit_from_network(people, plan)
    if not options.search:
        return fits
    # Far from keypoints that the network itself doubts, its body may be right: a search would follow them.
    form = skeleton(people.skeleton)
    rows = sorted(far_bodies(fits.parameters, fits.observations, plan.prior, form))
    if not rows:
        return fits
    stages = drawn_or_not(options.search, labels)
    some = people.select(rows)
    observations = given.select(torch.tensor(rows, device=given.points.device))
    better = _better(fits, rows, _search(some, observations, stages, plan), observations, plan)
    return [better[row] if row in better else fits[row] for row in range(len(fits))]


def _fit_from_network(people: CutPeople, plan: _Plan) -> tuple[BatchFits, Observations]:
    """Fit from the network's bodies; and what was seen, perhaps with longer lenses."""
    options, prior = plan.options, plan.prior
    stages = stages_of(options, people.observations.label_set)
    start = start_from_network(
        people.observations,
        plan.network,
        prior,
        options,
        bodies=plan.bodies,
        longer_lenses=plan.longer_lenses,
        doubting=plan.doubting,
        flips=bool(stages),
    )
    person_indices = torch.arange(len(people), device=start.bodies.shift.device)
    refined = refine_stages(
        start.bodies, person_indices, start.observations, stages, options, prior, progress=plan.progress
    )
    fits = BatchFits(
        people=people,
        observations=start.observations,
        stages=stages,
        parameters=sized(refined.bodies, start.given.statures),
        energy={name: term.cpu().numpy() for name, term in refined.terms.items()},
        history=refined.history,
        stage_seconds=start.seconds | refined.seconds,
        body_warnings=_warnings(refined.bodies, start.given, people, prior),
        depth_orders=start.depth_orders,
        uncertainty=start.uncertainty,
    )
    return fits, start.given


def _search(people: CutPeople, observations: Observations, stages: Sequence[Stage], plan: _Plan) -> BatchFits:
    """Fit from many hypotheses of each person, lifted in the first stage."""
    options, prior = plan.options, plan.prior
    hypotheses = [
        hypothesize(observations[row], stages[0].bodies, seed=options.seed) for row in range(len(observations))
    ]
    counts = torch.tensor([len(each.targets) for each in hypotheses], device=observations.points.device)
    person_indices = torch.arange(len(observations), device=observations.points.device).repeat_interleave(counts)
    bodies = BodyParameters.joined([each.bodies for each in hypotheses])
    bodies = replace(bodies, rotations=prior.mean_pose.expand(bodies.batch_size, NUM_PARTS, 3))
    of_bodies = observations.without_pictures().select(person_indices)
    bodies = sized(turned_to_lenses(bodies, of_bodies), of_bodies.statures)
    if observations.statures is not None:
        first = torch.searchsorted(person_indices, torch.arange(len(observations), device=person_indices.device))
        observations = replace(observations, lengths=bodies.lengths[first], thicknesses=bodies.thicknesses[first])
    targets = torch.cat([each.targets for each in hypotheses])
    known = torch.stack([each.known for each in hypotheses])[person_indices]
    refined = refine_stages(
        bodies,
        person_indices,
        observations,
        stages,
        options,
        prior,
        first_energy=lambda energy: LiftEnergy(energy, targets, known),
        progress=plan.progress,
    )
    return BatchFits(
        people=people,
        observations=observations,
        stages=tuple(stages),
        parameters=sized(refined.bodies, observations.statures),
        energy={name: term.cpu().numpy() for name, term in refined.terms.items()},
        history=refined.history,
        stage_seconds=refined.seconds,
        body_warnings=_warnings(refined.bodies, observations, people, prior),
        depth_orders=[None] * len(people),
        uncertainty=None,
        start="search",
        hypotheses=counts.tolist(),
        finalists=refined.finalists,
    )


def _warnings(
    bodies: BodyParameters, observations: Observations, people: CutPeople, prior: PosePrior
) -> dict[int, list[str]]:
    """Warnings of bodies that lie elsewhere than keypoints and labels, by rows. All keypoints count as they are."""
    body_warnings = far_bodies(bodies, observations, prior, skeleton(people.skeleton))
    poor = find_poor_labels(bodies, observations)
    return {row: body_warnings.get(row, []) + poor.get(row, []) for row in body_warnings | poor}


def _better(
    fits: BatchFits, rows: Sequence[int], searched: Sequence[FitResult], observations: Observations, plan: _Plan
) -> dict[int, FitResult]:
    """Fit with the lower energy, from the network or from the search, of each row; with the times of both."""
    judge = Energy(observations, weights=plan.options.weights, prior=plan.prior, renderer=plan.options.renderer)
    network = fits.parameters.select(torch.tensor(rows, device=observations.points.device))
    losses = []
    for bodies in (network, BodyParameters.joined([each.parameters for each in searched])):
        with torch.no_grad():
            losses.append(torch.stack(list(judge(bodies).values())).sum(0).tolist())
    chosen = {}
    for index, row in enumerate(rows):
        both = fits[row], searched[index]
        seconds = {f"{name}, {each.start}": value for each in both for name, value in each.stage_seconds.items()}
        hypotheses = sum(each.hypotheses for each in both)
        best = both[1] if losses[1][index] < losses[0][index] else both[0]
        chosen[row] = replace(best, stage_seconds=seconds, hypotheses=hypotheses)
    return chosen


def _check_camera(camera: Perspective | None) -> None:
    check_type("camera", camera, Perspective | None, "such as Perspective.of_picture(size, focal=1500)")
    if camera is not None:
        check_square(camera)
