"""Mesh stage: the detailed body itself is drawn and refined until it shows what the labels do ("PartDR + SMPL").

Ellipsoids can't have a person's outline: the better they follow labels, the farther joints drift. A detailed body can.
It starts where a fit's ellipsoids are, and its pose and depth are held as hard as the network was sure of them. Clothes
and hair are thicknesses over it. In the end EllipBody is measured from it, so that both are one body.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...body.lens import move_pelvises, place_bodies
from ...body.parameters import BodyParameters
from ...body.rotations import rotation_to_6d, rotation_to_axis_angle
from ...cameras import Camera
from ...errors import InputError, check_type
from ...inputs.observation import REFERENCE_SIZE
from ...interop.checks import check_finite
from ...interop.gradient_mode import with_gradients
from ...interop.movable import Movable
from ...interop.torch_threads import one_torch_thread
from ...models.anny import anny
from ...models.clothes import bounded
from ...models.measuring import measure_ellipbody, statures
from ...models.model import DetailedModel, detailed_mesh
from ...models.registration import Registered, ungrown
from ...models.resizing import resize_shapes
from ...render.mesh import PartImage, draw_mesh
from ..ellipsoids.result import FitResult
from ..ellipsoids.stages import Progress
from .energy import MeshEnergy, mesh_energy
from .gather import gather_starts
from .given_poses import GivenPoses
from .mesh_options import MeshOptions
from .observed_body import ObservedBody
from .steps import RefinedPeople, refine_starts


@dataclass(frozen=True)
class MeshFit(Movable):
    """Detailed body of a mesh stage.

    Attributes:
        first: The fit that it went on from.
        body: The detailed body in the camera frame, as ``register`` gives one; with weak perspective near the origin.
            Its losses are the energy's terms before the last step.
        ellipbody: The same body as EllipBody, measured from it.
        clothes: Thicknesses of clothes and hair on its parts ``CLOTHED`` [m], shape (1, 8), which the body is without.
    """

    first: FitResult
    body: Registered
    ellipbody: FitResult
    clothes: torch.Tensor

    @property
    def camera(self) -> Camera:
        """The camera, in pixels of the full picture."""
        return self.ellipbody.camera

    @property
    def vertices(self) -> np.ndarray:
        """Vertices of the body without clothes, in the camera frame, shape (V, 3) [m]."""
        return self.body.detailed.vertices[0].cpu().numpy()

    def landmarks(self, names: Sequence[str]) -> np.ndarray:
        """Landmarks in the camera frame, shape (L, 3) [m]."""
        return self.body.model.landmarks(self.body.detailed, names)[0].cpu().numpy()

    def draw(self, image_size: tuple[int, int], *, camera: Camera | None = None) -> PartImage:
        """Draw the body's 20 parts, clothed, in the full picture of (H, W) pixels, or in another camera's.

        Neck, arms and legs begin at their joints if those of the fit's label set do, else where the skin follows them.
        """
        labels = self.first.observation.label_set
        mesh = detailed_mesh(self.body.model, labels is not None and labels.at_joints)
        return draw_mesh(self.body.clothed(self.clothes).vertices, mesh, camera or self.camera, image_size)


def refine_mesh(
    result: FitResult,
    model: DetailedModel | None = None,
    *,
    options: MeshOptions | None = None,
    progress: Progress | None = None,
) -> MeshFit:
    """Refine a detailed body from a fit on, against the same labels and keypoints.

    Args:
        result: Fit of ``fit_body``, best without an outline stage, which costs joints.
        model: On the result's device, float32; default Anny.
        options: Iterations, size and weights.
        progress: Told the stage, how many iterations are done and how many there are.

    Raises:
        TypeError: If an argument is of another type.
        ValueError: If the mesh can't have so many vertices, or the model is elsewhere or not float32.
    """
    check_type("result", result, FitResult, "of fit_body")
    return refine_meshes([result], model, options=options, progress=progress)[0]


@one_torch_thread()
@with_gradients()
def refine_meshes(
    results: Sequence[FitResult],
    model: DetailedModel | None = None,
    *,
    options: MeshOptions | None = None,
    starts: Sequence[Registered] | None = None,
    progress: Progress | None = None,
) -> list[MeshFit]:
    """Refine the detailed bodies of many people side by side, each as ``refine_mesh`` does.

    Those with labels of one set make a batch; so do those with a known camera and those without. On CUDA a batch's
    steps are one captured graph, kept for the next batch of as many people.

    Args:
        results: Of ``fit_body``, on one device.
        model: As of ``refine_mesh``, as the other arguments and what is raised.
        options: Of all.
        starts: Bodies of that model to start from, one a result and its pelvis at the origin, of ``begin_at``; None:
            those that have the results' EllipBodies' bones and pose.
        progress: Told of all batches' iterations.
    """
    results = list(results)  # of which some make each when it is asked for
    for result in results:
        check_type("results", result, FitResult, "of fit_body")
    check_type("model", model, DetailedModel | None, "of load_model, or anny()")
    check_type("options", options, MeshOptions | None, "such as MeshOptions()")
    options = options or MeshOptions()
    batches: dict[tuple[MeshEnergy, bool], list[int]] = {}
    for place, result in enumerate(results):
        model = _checked_model(model, result)
        energy = mesh_energy(model, options, result.observation.label_set)
        batches.setdefault((energy, result.observation.lens is None), []).append(place)
    found: dict[int, MeshFit] = {}
    done, total = 0, options.iterations * len(batches)

    def tell(iterations: int) -> None:
        if progress is not None:
            progress("mesh", done + iterations, total)

    for (energy, _), places in batches.items():
        assert model is not None
        some, given = [results[place] for place in places], None
        if starts is not None:
            given = GivenPoses.of([starts[place] for place in places], energy.drawn.turning)
        found |= zip(places, _refine_batch(energy, model, some, given, tell), strict=True)
        done += options.iterations
    return [found[place] for place in range(len(results))]


def _checked_model(model: DetailedModel | None, result: FitResult) -> DetailedModel:
    like = result.parameters.shift
    model = model or anny(like.device)
    given = model.rest_vertices
    if (given.dtype, given.device) != (like.dtype, like.device):
        expected = f"{like.dtype} on {like.device}, as the result"
        raise ValueError(f"model: {given.dtype} on {given.device}; expected {expected}")
    return model


def _refine_batch(
    energy: MeshEnergy,
    model: DetailedModel,
    results: Sequence[FitResult],
    given: GivenPoses | None,
    progress: Callable[[int], None],
) -> list[MeshFit]:
    started = time.perf_counter()
    with torch.no_grad():
        people = gather_starts(energy, model, [ObservedBody.of_fit(each) for each in results], given)
    refined = refine_starts(energy, people, progress)
    with torch.no_grad():
        return _finish(energy, model, refined, results, given, started)


def _finish(
    energy: MeshEnergy,
    model: DetailedModel,
    refined: RefinedPeople,
    results: Sequence[FitResult],
    given: GivenPoses | None,
    started: float,
) -> list[MeshFit]:
    """Detailed bodies where their cameras see them, and EllipBodies measured from them."""
    people, found, terms = refined.people, refined.unknowns, refined.terms
    shape, rotations, translation = energy.drawn.whole_pose(model, people, found)
    log_scale = found.log_scale
    if any(result.stature is not None for result in results):
        shape, shares = _resized(model, shape, results)
        translation, log_scale = translation * shares[:, None], log_scale - shares.log()
    if given is not None:
        rotations = given.whole(rotations[:, energy.drawn.turning])
    bodies = ungrown(model, shape, rotations, translation, terms)
    numbers = {name: term.tolist() for name, term in terms.items()}
    energies = [{name: values[place] for name, values in numbers.items()} for place in range(len(results))]
    origins = CropPositions(log_scale, found.shift, people.lens)
    try:
        fits = mesh_fits(bodies, origins, bounded(found.clothes), results, energies)
    except ValueError as error:
        told = f"learning_rate: {energy.options.learning_rate}; the mesh stage went astray ({error})"
        raise InputError(f"{told}; expected a smaller rate, or smaller weights of its terms") from error
    seconds = (time.perf_counter() - started) / len(results)
    for fit in fits:
        fit.ellipbody.stage_seconds["mesh"] = seconds
    return fits


def _resized(
    model: DetailedModel, shape: torch.Tensor, results: Sequence[FitResult]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Shape values (B, S) of those whose stature is known as tall as they are, and how many times as large (B,)."""
    wanted = statures(model, shape)
    for place, result in enumerate(results):
        if result.stature is not None:
            wanted[place] = result.stature
    return resize_shapes(model, shape, wanted)


@dataclass(frozen=True)
class CropPositions:
    """Positions of B points as the cameras of their crops see them.

    Attributes:
        log_scale: As of ``BodyParameters``, like ``shift``, shape (B,).
        shift: Shape (B, 2).
        lens: Lenses of the cameras as of ``Observation``, shape (B, 3); None: weak perspective.
    """

    log_scale: torch.Tensor
    shift: torch.Tensor
    lens: torch.Tensor | None


def mesh_fits(
    bodies: Registered,
    origins: CropPositions,
    clothes: torch.Tensor,
    results: Sequence[FitResult],
    energies: Sequence[dict[str, float]],
) -> list[MeshFit]:
    """Detailed bodies of B people where their cameras see them, with EllipBodies measured from them.

    Args:
        bodies: About the origin.
        origins: Positions of the origin in the crops of the results.
        clothes: Thicknesses [m], shape (B, 8).
        results: The fits that they went on from.
        energies: Weighted terms by name; of a person without any, the result's stay.

    Raises:
        ValueError: If a number is not finite.
    """
    measured, pelvises = measure_parameters(bodies, origins)
    there, _ = place_bodies(measured, measured.posed(), origins.lens, REFERENCE_SIZE)
    bodies = bodies.moved(there.joints[:, 0] - pelvises)
    check_finite(vertices=bodies.detailed.vertices, scale=measured.log_scale.exp(), shift=measured.shift)
    fits: list[MeshFit] = []
    for place, (result, energy) in enumerate(zip(results, energies, strict=True)):
        own = slice(place, place + 1)
        ellipbody = replace(
            result,
            parameters=measured.select(own),
            energy=energy or result.energy,
            stage_seconds=dict(result.stage_seconds),
        )
        fits.append(MeshFit(result, bodies.select(own), ellipbody, clothes[own]))
    return fits


def measure_parameters(bodies: Registered, origins: CropPositions) -> tuple[BodyParameters, torch.Tensor]:
    """EllipBodies measured from detailed bodies about the origin, whose position is known, and their pelvises."""
    orientation, pelvises, turns, lengths, thicknesses = measure_ellipbody(bodies)
    measured = BodyParameters(
        orientation=rotation_to_6d(orientation),
        rotations=rotation_to_axis_angle(turns),
        lengths=lengths,
        thicknesses=thicknesses,
        log_scale=origins.log_scale,
        shift=origins.shift,
    )
    return move_pelvises(measured, origins.lens, pelvises), pelvises
