"""Mesh stage: a detailed body is drawn and refined until it agrees with the labels ("PartDR + SMPL").

Ellipsoids can't have a person's outline: the better they follow labels, the farther their joints move from the truth. A
detailed body can. It starts at a fit of ellipsoids. The network's uncertainty of pose and depth decides how far both
may move. Clothes and hair are thicknesses over the body. In the end EllipBody is measured from the detailed body, so
that both are the same body.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...body.lens import move_pelvises, place_bodies
from ...body.parameters import BodyParameters
from ...body.rotations import replayed_axis_angles, rotation_to_6d
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
        first: Fit of ellipsoids from which the stage went on.
        body: Detailed body in the camera frame, without clothes, as ``register`` returns one. With weak perspective it
            is near the origin. Its losses are the energy's terms before the last step.
        ellipbody: Fit whose EllipBody is measured from the detailed body.
        clothes: Thicknesses of clothes and hair on the parts ``CLOTHED`` [m], shape (1, 8).
    """

    first: FitResult
    body: Registered
    ellipbody: FitResult
    clothes: torch.Tensor

    @property
    def camera(self) -> Camera:
        """Camera in pixels of the full picture."""
        return self.ellipbody.camera

    @property
    def vertices(self) -> np.ndarray:
        """Vertices of the body without clothes, in the camera frame, shape (V, 3) [m]."""
        return self.body.detailed.vertices[0].cpu().numpy()

    def with_warnings(self, warnings: Sequence[str]) -> MeshFit:
        """Return the same fit with more warnings."""
        return replace(self, ellipbody=replace(self.ellipbody, warnings=(*self.ellipbody.warnings, *warnings)))

    def landmarks(self, names: Sequence[str]) -> np.ndarray:
        """Landmarks in the camera frame, shape (L, 3) [m]."""
        return self.body.model.landmarks(self.body.detailed, names)[0].cpu().numpy()

    def draw(self, image_size: tuple[int, int], *, camera: Camera | None = None) -> PartImage:
        """Draw the 20 parts of the clothed body.

        Neck, arms and legs begin at their joints if they do so in the fit's label set. Otherwise they begin where the
        skin follows them.

        Args:
            image_size: Height and width (H, W) of the picture [px].
            camera: Camera to draw with; None: the fit's camera, which draws in the full picture.
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
        result: Result of ``fit_body``, from whose body the stage starts. Best is one without an outline stage, which
            moves joints away from the truth.
        model: Detailed model, float32, on the result's device; None: Anny.
        options: Iterations, size and weights.
        progress: Function that is called with (stage name, iterations done, iterations in all).

    Returns:
        Detailed body, and EllipBody measured from it.

    Raises:
        TypeError: If an argument is of another type.
        ValueError: If the mesh can't have so few or so many vertices, or the model is on another device or not float32.

    Examples:
        After ``result = fit_body(person, parts)``:

        >>> from warp_partdr import refine_mesh
        >>> mesh = refine_mesh(result)
        >>> mesh.vertices.shape  # Anny's, in the camera frame [m]
        (13718, 3)
        >>> mesh.ellipbody.posed.joints.shape  # EllipBody measured from it
        torch.Size([1, 21, 3])
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
    """Refine the detailed bodies of many people in batches, each person as ``refine_mesh`` does.

    A batch has people with labels of one set, and either all or none of them have a camera with perspective. On CUDA,
    the steps of a batch are one captured graph, which is kept for the next batch of the same size.

    Args:
        results: Results of ``fit_body``, on one device.
        model: Detailed model, float32, on the results' device; None: Anny.
        options: Iterations, size and weights for all people.
        starts: Bodies of that model to start from, one for each result, with the pelvis at the origin, from
            ``begin_at``. None: bodies with the bones and the pose of the results' EllipBodies.
        progress: Function that is called with (stage name, iterations done, iterations in all), which count over all
            batches.

    Returns:
        Fit of each person.

    Raises:
        TypeError: If an argument is of another type.
        ValueError: If the mesh can't have so few or so many vertices, or the model is on another device or not float32.

    Examples:
        After ``result = fit_body(person, parts)``:

        >>> from warp_partdr import refine_meshes
        >>> [mesh.vertices.shape for mesh in refine_meshes([result, result])]
        [(13718, 3), (13718, 3)]
    """
    results = list(results)  # a lazy sequence would make each result again at each use
    for result in results:
        check_type("results", result, FitResult, "of fit_body")
    check_type("model", model, DetailedModel | None, "of load_model, or anny()")
    check_type("options", options, MeshOptions | None, "such as MeshOptions()")
    options = options or MeshOptions()
    batches: dict[tuple[MeshEnergy, bool], list[int]] = {}
    for index, result in enumerate(results):
        model = _checked_model(model, result)
        energy = mesh_energy(model, options, result.observation.label_set)
        batches.setdefault((energy, result.observation.lens is None), []).append(index)
    found: dict[int, MeshFit] = {}
    done, total = 0, options.iterations * len(batches)

    def report(iterations: int) -> None:
        if progress is not None:
            progress("mesh", done + iterations, total)

    for (energy, _), indices in batches.items():
        assert model is not None
        some = [results[index] for index in indices]
        given = None
        if starts is not None:
            given = GivenPoses.of([starts[index] for index in indices], energy.drawn.turning)
        found |= zip(indices, _refine_batch(energy, model, some, given, report), strict=True)
        done += options.iterations
    return [found[index] for index in range(len(results))]


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
    """Place the refined bodies where their cameras see them, and measure EllipBodies from them."""
    people = refined.people
    found = refined.unknowns
    terms = refined.terms
    shape, rotations, translation = energy.drawn.whole_pose(model, people, found)
    log_scale = found.log_scale
    if any(result.stature is not None for result in results):
        shape, shares = _resized(model, shape, results)
        translation = translation * shares[:, None]
        log_scale = log_scale - shares.log()
    if given is not None:
        rotations = given.whole(rotations[:, energy.drawn.turning])
    bodies = ungrown(model, shape, rotations, translation, terms)
    origins = CropPositions(log_scale, found.shift, people.lens)
    try:
        fits = mesh_fits(bodies, origins, bounded(found.clothes), results)
    except ValueError as error:
        failed = f"learning_rate: {energy.options.learning_rate}; the mesh stage went astray ({error})"
        raise InputError(f"{failed}; expected a smaller rate, or smaller weights of its terms") from error
    seconds = (time.perf_counter() - started) / len(results)
    for fit in fits:
        fit.ellipbody.stage_seconds["mesh"] = seconds
    return fits


def _resized(
    model: DetailedModel, shape: torch.Tensor, results: Sequence[FitResult]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Resize shapes to known statures.

    Returns:
        Shape values (B, S), and the factors by which the bodies grew (B,).
    """
    wanted = statures(model, shape)
    for index, result in enumerate(results):
        if result.stature is not None:
            wanted[index] = result.stature
    return resize_shapes(model, shape, wanted)


@dataclass(frozen=True)
class CropPositions:
    """Positions of B points as the cameras of their crops see them.

    Attributes:
        log_scale: Logarithms of the scale at the points, as in ``BodyParameters``, shape (B,).
        shift: Positions in the crops, as in ``BodyParameters`` [half-sides of the crop], shape (B, 2).
        lens: Lenses of the cameras, as in ``Observation``, shape (B, 3); None: weak perspective.
    """

    log_scale: torch.Tensor
    shift: torch.Tensor
    lens: torch.Tensor | None


def mesh_fits(
    bodies: Registered,
    origins: CropPositions,
    clothes: torch.Tensor,
    results: Sequence[FitResult],
) -> list[MeshFit]:
    """Place B detailed bodies where their cameras see them, and measure EllipBodies from them.

    Args:
        bodies: Detailed bodies near the origin, whose losses are the weighted terms of the energy. Without losses, the
            fits keep the energies of the results.
        origins: Positions of the origin in the crops of the results.
        clothes: Thicknesses of clothes [m], shape (B, 8).
        results: Fits from which the stage went on.

    Returns:
        Fit of each person.

    Raises:
        ValueError: If a number is not finite.
    """
    measured, pelvises = measure_parameters(bodies, origins)
    placed, _ = place_bodies(measured, measured.posed(), origins.lens, REFERENCE_SIZE)
    bodies = bodies.moved(placed.joints[:, 0] - pelvises)
    # Until here nothing waits for the device, which meanwhile takes the steps: each person's tensors can be told apart
    # before they hold numbers.
    people = list(zip(results, measured.split(), bodies.split(), clothes.split(1), strict=True))
    check_finite(vertices=bodies.detailed.vertices, scale=measured.log_scale.exp(), shift=measured.shift)
    energies = _rows(bodies.losses, len(people))
    fits: list[MeshFit] = []
    for (result, parameters, body, own_clothes), energy in zip(people, energies, strict=True):
        seconds = dict(result.stage_seconds)
        ellipbody = replace(result, parameters=parameters, energy=energy or result.energy, stage_seconds=seconds)
        fits.append(MeshFit(result, body, ellipbody, own_clothes))
    return fits


def _rows(terms: dict[str, torch.Tensor], count: int) -> list[dict[str, float]]:
    """Terms of each of so many people by name; the device is waited for once."""
    if not terms:
        return [{} for _ in range(count)]
    return [dict(zip(terms, row, strict=True)) for row in torch.stack(list(terms.values()), dim=1).tolist()]


def measure_parameters(bodies: Registered, origins: CropPositions) -> tuple[BodyParameters, torch.Tensor]:
    """Measure EllipBodies from detailed bodies.

    Args:
        bodies: B detailed bodies near the origin.
        origins: Positions of the origin in the crops.

    Returns:
        EllipBodies with their cameras, and the positions of their pelvises relative to the origin [m], shape (B, 3).
    """
    orientation, pelvises, turns, lengths, thicknesses = measure_ellipbody(bodies)
    measured = BodyParameters(
        orientation=rotation_to_6d(orientation),
        rotations=replayed_axis_angles(turns),
        lengths=lengths,
        thicknesses=thicknesses,
        log_scale=origins.log_scale,
        shift=origins.shift,
    )
    return move_pelvises(measured, origins.lens, pelvises), pelvises
