"""Fits of many people side by side: the label network is asked about all at once, and one captured graph refines them.

The stages are those of ``fit_body``. What that one does for a person alone is left out: a search where the network's
body ends far from what was seen, which is told in the warnings instead. Cameras, known or assumed, are those of the
people who are given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np
import torch

from ...body.lens import turn_to_rays
from ...body.parameters import BodyParameters
from ...body.pose_prior import packaged_prior
from ...body.skeletons import Skeleton, skeleton
from ...errors import check_each, check_type
from ...inputs.cut_people import CutPeople, CutPerson, stack_alike
from ...inputs.stacked import StackedObservations
from ...interop.gradient_mode import with_gradients
from ...interop.torch_threads import one_torch_thread
from ...networks.regression.label_network import LabelNetwork
from ...networks.regression.predict import ask_network
from ...networks.regression.uncertainty import Uncertainty
from .batch import Batch
from .captured import refine_captured
from .depth_flips import DepthOrder, repair_depth_orders
from .energy import SEG, Energy
from .far_people import shows_parts, with_longer_lens
from .options import FitOptions, stages_of
from .plausibility import MOST_OFF, MOST_WRONG, describe_misfit, person_pixels
from .result import FitResult
from .stages import OUTLINE, Stage
from .wrong_keypoints import doubt_keypoints

JUDGED_SIZE = 128  # [px], side of the crop in which bodies are compared with labels in the end


@dataclass(frozen=True, eq=False)
class BatchFits(Sequence[FitResult]):
    """Fits of N people as arrays of all; a person's ``FitResult`` is made when it is asked for.

    Attributes:
        people: Who was fitted, as they were given.
        seen: Their observations as the fits saw them: with longer lenses, and less confidence in keypoints.
        stages: Stages of the fits.
        parameters: Bodies and their cameras in the crops, B = N.
        hints: Expected sizes and depths, by their names in ``Observation``: tensors of N rows each.
        energy: Weighted terms of the energy at the end by name, shape (N,).
        history: Energy before each iteration, shape (N, iterations), of each stage.
        told: Warnings of bodies by their rows; most have none.
        depth_orders: Limbs that were tried mirrored in depth.
        uncertainty: How sure the network was, B = N.
        before_outline: Bodies where the outline stage began, B = N; None without that stage.
    """

    people: CutPeople
    seen: StackedObservations
    stages: tuple[Stage, ...]
    parameters: BodyParameters
    hints: Mapping[str, Any]
    energy: Mapping[str, np.ndarray]
    history: Sequence[np.ndarray]
    told: Mapping[int, list[str]]
    depth_orders: Sequence[DepthOrder | None]
    uncertainty: Uncertainty
    before_outline: BodyParameters | None

    def __len__(self) -> int:
        """Number of people, N."""
        return len(self.people)

    @overload
    def __getitem__(self, index: int) -> FitResult: ...
    @overload
    def __getitem__(self, index: slice) -> list[FitResult]: ...
    def __getitem__(self, index: int | slice) -> FitResult | list[FitResult]:
        """The fit of one person, or of some."""
        if isinstance(index, slice):
            return [self[row] for row in range(*index.indices(len(self)))]
        row = range(len(self))[index]
        own, person = slice(row, row + 1), self.people[row]
        return FitResult(
            parameters=self.parameters.select(own),
            crop=person.crop,
            observation=replace(self.seen[row], **{name: values[row] for name, values in self.hints.items()}),
            stages=self.stages,
            energy={name: float(values[row]) for name, values in self.energy.items()},
            history=[each[row] for each in self.history],
            stage_seconds={},
            hypotheses=1,
            finalists=[],
            start="network",
            evidence=person.evidence,
            warnings=self.warnings(row),
            depth_order=self.depth_orders[row],
            uncertainty=self.uncertainty.select(own),
            before_outline=None if self.before_outline is None else self.before_outline.select(own),
        )

    def warnings(self, row: int) -> tuple[str, ...]:
        """Faults of one person's input or body, a sentence each."""
        return (*self.people.warnings[row], *self.told.get(row, ()))

    def losses(self) -> list[float] | None:
        """Energies at the end, the sums of their terms; None without stages."""
        if not self.energy:
            return None
        return sum(values.astype(np.float64) for values in self.energy.values()).tolist()  # type: ignore[union-attr]


@one_torch_thread()
@with_gradients()
def fit_together(people: Sequence[CutPerson], options: FitOptions, network: LabelNetwork) -> Sequence[FitResult]:
    """Fit EllipBody to many people side by side.

    Args:
        people: On the network's device.
        options: Of a start by the network; without stages, its bodies stay as they are. Their stages draw exact
            ellipsoids.
        network: In evaluation mode; ``options.network`` is not looked at.

    Returns:
        A fit of each. Seconds of stages are not measured, and nothing is compared: ``finalists`` are empty. Of people
        who are alike, these are ``BatchFits``.

    Raises:
        TypeError: If an argument is of another type.
        ValueError: If the options ask for a search or have a stature, or somebody's labels are probabilities.
    """
    if not isinstance(people, CutPeople):
        check_each("people", people, CutPerson, "of crop_evidence")
    check_type("options", options, FitOptions, "such as FitOptions.at('fast')")
    if options.start != "network":
        raise ValueError(f"options.start: {options.start!r}; expected 'network'")
    if options.stature is not None:
        raise ValueError(f"options.stature: {options.stature:g}, of many people; expected none")
    if isinstance(people, CutPeople):
        return _fit_alike(people, options, network)
    for place, person in enumerate(people):
        if person.observation.maps is not None:
            raise ValueError(f"people[{place}]: probabilities of labels; expected labels")
    stacked = stack_alike(people)
    if len(stacked) == 1:
        return _fit_alike(stacked[0][1], options, network)
    found: dict[int, FitResult] = {}
    for places, some in stacked:
        found |= zip(places, _fit_alike(some, options, network), strict=True)
    return [found[place] for place in range(len(people))]


def _fit_alike(people: CutPeople, options: FitOptions, network: LabelNetwork) -> BatchFits:
    seen = people.seen
    prior = packaged_prior(str(seen.points.device))
    predicted = ask_network(seen, network, mirror=options.mirror, half=options.half)
    longer = with_longer_lens(seen, predicted)
    if longer is not None:
        assert seen.lens is not None  # it was lengthened
        assert longer.lens is not None
        changed = (longer.lens != seen.lens).any(1).nonzero()[:, 0]
        if seen.points.is_cuda:  # all of them again: for as many people as before, a captured graph is there
            changed = torch.arange(len(seen), device=changed.device)
        again = ask_network(longer.select(changed), network, mirror=options.mirror, half=options.half)
        seen, predicted = longer, predicted.with_rows(changed, again)
    said = predicted.uncertainty
    assert said is not None
    bodies = predicted.parameters()
    if seen.lens is not None:
        bodies = turn_to_rays(bodies, seen.lens)
    lengths, thicknesses = bodies.lengths, bodies.thicknesses
    given, seen = seen, doubt_keypoints(seen, predicted)
    first = replace(seen[0], lengths=lengths[0], thicknesses=thicknesses[0])
    # Of a person alone, what is drawn differs from stage to stage.
    everyone = replace(Batch.of_stacked(seen, Energy(first, 1, prior=prior)), lengths=lengths, thicknesses=thicknesses)
    stages = stages_of(options, first.label_set)
    orders: Sequence[DepthOrder | None] = [None] * len(people)
    several = shows_parts(seen)
    if stages and several and options.depth_flips:
        bodies, orders = repair_depth_orders(bodies, [first], prior, everyone, said=said)
    depths, spreads = bodies.posed().centres[..., 2], said.centre_depths()
    first = replace(first, depths=depths[0], depth_spreads=spreads[0])
    everyone = replace(everyone, depths=depths, depth_scales=1 / spreads)
    terms: dict[str, torch.Tensor] = {}
    history: list[np.ndarray] = []
    before_outline: BodyParameters | None = None
    for stage in stages:
        if stage.name == OUTLINE:
            before_outline = bodies
        energy = options.energy(stage, first, prior)
        rule = {"iterations": stage.iterations, "learning_rate": stage.learning_rate, "frozen": stage.frozen}
        refined = refine_captured(bodies, energy, rule, people=everyone.drawn_at(stage.size or 1))
        bodies, terms = refined.parameters, refined.terms
        history.append(refined.history.T.cpu().numpy())
    judge = Energy(first, JUDGED_SIZE, prior=prior)
    judged = everyone.believing(given).drawn_at(JUDGED_SIZE)
    warnings = _complaints(bodies, judged, judge, skeleton(people.skeleton))
    return BatchFits(
        people=people,
        seen=seen,
        stages=stages,
        parameters=bodies,
        hints={"lengths": lengths, "thicknesses": thicknesses, "depths": depths, "depth_spreads": spreads},
        energy={name: term.cpu().numpy() for name, term in terms.items()},
        history=history,
        told=warnings,
        depth_orders=orders,
        uncertainty=said,
        before_outline=before_outline,
    )


def _complaints(bodies: BodyParameters, people: Batch, energy: Energy, form: Skeleton) -> dict[int, list[str]]:
    """Warnings of what bodies are too far from, as ``complaints`` of one, at once and of a smaller picture, by row."""
    terms = refine_captured(bodies, energy, {"iterations": 0}, people=people).terms
    offs = terms["proj"] / energy.weights.proj / people.votes.sum(1)
    bad, wrongs = ~(offs < MOST_OFF), None
    if people.targets is not None:
        wrongs = terms[SEG.name] / energy.weight(SEG) / (2 * person_pixels(people.targets))
        bad |= ~(wrongs < MOST_WRONG)
    rows = bad.nonzero()[:, 0]
    shares = [None] * len(rows) if wrongs is None else wrongs[rows].tolist()
    named = zip(rows.tolist(), offs[rows].tolist(), shares, strict=True)
    return {row: describe_misfit(off, wrong, form) for row, off, wrong in named}
