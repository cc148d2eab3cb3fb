"""Mesh stage: the detailed body itself is drawn and refined until it shows what the labels do ("PartDR + SMPL").

Ellipsoids can't have a person's outline: the better they follow labels, the farther joints drift. A detailed body can.
It starts where a fit's ellipsoids are, and its pose and depth are held as hard as the network was sure of them. Clothes
and hair are thicknesses over it. In the end EllipBody is measured from it, so that both are one body.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch

from ..body.lens import find_camera, move_pelvises
from ..body.parameters import BodyParameters
from ..body.pose_prior import FREE_PARTS
from ..body.rotations import rotation_to_6d, rotation_to_axis_angle
from ..body.template import JOINT_NAMES
from ..cameras import Camera
from ..clothing.anny import anny
from ..clothing.clothes import CLOTHED, SPREAD, bounded, clothes_basis, clothes_offsets
from ..clothing.measuring import measure_ellipbody
from ..clothing.model import Detailed, DetailedModel, detailed_mesh
from ..clothing.pose import free_joints, pose_from_ellipbody, turn_joints
from ..clothing.reduction import reduce_model
from ..clothing.registration import Registered, shape_from_lengths, ungrown
from ..errors import check_type, check_whole
from ..inputs.observation import REFERENCE_SIZE, Observation, resize_nearest
from ..interop.adam import Adam
from ..interop.checks import MAX_PICTURE, check_steps
from ..interop.movable import Movable
from ..interop.torch_threads import one_torch_thread
from ..network.uncertainty import Uncertainty
from ..refinement.energy import landmark_votes
from ..refinement.stepper import rate_share
from ..render.mesh import PartImage, draw_mesh, mesh_label_loss
from ..render.options import DEFAULT_DEPTH_WEIGHT, MeshGradient, check_mesh_rule
from ..render.part_mesh import PartMesh
from .fitting import Progress
from .result import FitResult

# Of shape values, whose variance is 1, and of thicknesses [m], against radians and half-sides of the crop.
_SHAPE_RATE, _CLOTHES_RATE = 5.0, 0.3
# Where no network said how sure it is, and of joints that it says nothing of: depth [m] and turns [rad].
_DEPTH_SPREAD, _TURN_SPREAD, _LOCKED_SPREAD = 0.1, 0.3, 0.05


@dataclass(frozen=True)
class MeshOptions:
    """Options of the mesh stage; weights are of terms in the units of ``Energy``'s.

    Attributes:
        iterations: Steps of Adam.
        learning_rate: Of angles [rad] and camera [half-sides of the crop].
        size: Side of the drawn crop [px].
        vertices: Of the mesh that is drawn meanwhile (``reduce_model``), where the model has more.
        proj: Weight of L_proj.
        seg: Weight of L_seg.
        depth: Weight of the squares of joints' moves along the view, in spreads that the network stated.
        turns: Weight of the squares of joints' turns, in such spreads.
        shape: Weight of half the squares of changes of the shape values.
        clothes: Weight of half the squares of the clothes' thicknesses, in their standard deviations; None: the person
            wears none.
        gradient: Of L_seg, "edges" or "partdr", as ``mesh_label_loss``; "partdr" pulls about thrice as hard.
        max_distance: "partdr": greatest distance from an edge of a pixel that moves it [px].
        depth_weight: "partdr": the paper's lambda of the z gradient (eq. 12).
    """

    iterations: int = 60
    learning_rate: float = 0.01
    size: int = 160
    vertices: int = 1500
    proj: float = 0.5
    seg: float = 0.1
    depth: float = 2.0
    turns: float = 8.0
    shape: float = 1.0
    clothes: float | None = 1.0
    gradient: MeshGradient = "edges"
    max_distance: float = 3.0
    depth_weight: float = DEFAULT_DEPTH_WEIGHT

    def __post_init__(self) -> None:
        check_steps(self.iterations, self.learning_rate)
        check_whole("size", self.size, 1, math.isqrt(MAX_PICTURE) - 1)
        check_mesh_rule(self.gradient, self.max_distance, self.depth_weight)
        for name in ("proj", "seg", "depth", "turns", "shape", "clothes"):
            weight = getattr(self, name)
            if not (0 <= weight < math.inf if weight is not None else name == "clothes"):
                raise ValueError(f"{name}: {weight}; expected 0 or a positive number")


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
        """The body's, in the camera frame, shape (V, 3) [m]."""
        return self.body.detailed.vertices[0].cpu().numpy()

    def landmarks(self, names: Sequence[str]) -> np.ndarray:
        """Landmarks in the camera frame, shape (L, 3) [m]."""
        return self.body.model.landmarks(self.body.detailed, names)[0].cpu().numpy()

    def draw(self, image_size: tuple[int, int]) -> PartImage:
        """Its 20 parts, clothed, in the full picture of (H, W) pixels."""
        clothed = self.body.clothed(self.clothes)
        return draw_mesh(clothed.vertices, detailed_mesh(self.body.model), self.camera, image_size)


@one_torch_thread()
def refine_mesh(
    result: FitResult,
    model: DetailedModel | None = None,
    *,
    options: MeshOptions | None = None,
    progress: Progress | None = None,
) -> MeshFit:
    """Refine a detailed body from a fit on, against the same labels and keypoints.

    Args:
        result: Of ``fit_body``; it goes on from where the outline stage began, which costs joints.
        model: On the result's device, float32; default Anny.
        options: Iterations, size and weights.
        progress: Told the stage, how many iterations are done and how many there are.

    Raises:
        TypeError: If an argument is of another type.
        ValueError: If the mesh can't have so many vertices, or the model is elsewhere or not float32.
    """
    check_type("result", result, FitResult, "of fit_body")
    check_type("model", model, DetailedModel | None, "of load_model, or anny()")
    check_type("options", options, MeshOptions | None, "such as MeshOptions()")
    options = options or MeshOptions()
    iterations, started = options.iterations, time.perf_counter()
    start = result.before_outline or result.parameters
    posed = start.posed()
    model = model or anny(posed.joints.device)
    like = model.rest_vertices
    if (like.dtype, like.device) != (posed.joints.dtype, posed.joints.device):
        expected = f"{posed.joints.dtype} on {posed.joints.device}, as the result"
        raise ValueError(f"model: {like.dtype} on {like.device}; expected {expected}")
    body = _Body(model, start, shape_from_lengths(model, posed))
    energy = _MeshEnergy(body, result.observation, result.uncertainty, options)
    pose = [body.turns, body.log_scale, body.shift]
    adam = Adam(
        [
            (pose, options.learning_rate),
            ([body.shape], _SHAPE_RATE * options.learning_rate),
            ([body.clothes], _CLOTHES_RATE * options.learning_rate),
        ]
    )
    terms: dict[str, torch.Tensor] = {}
    for iteration in range(iterations):
        terms = energy()
        torch.stack(list(terms.values())).sum().backward()
        adam.step(rate_share(iteration, iterations))
        if progress is not None:
            progress("mesh", iteration + 1, iterations)
    with torch.no_grad():
        return _finish(body, result, terms, time.perf_counter() - started)


def _finish(body: _Body, result: FitResult, terms: dict[str, torch.Tensor], seconds: float) -> MeshFit:
    """The detailed body where the camera sees it, and EllipBody measured from it."""
    shape, rotations, translation = body.shape.detach(), body.rotations(), body.translation
    about_start = ungrown(body.model, shape, rotations, translation, terms)
    orientation, pelvis, turns, lengths, thicknesses = measure_ellipbody(about_start)
    found = BodyParameters(
        rotation_to_6d(orientation),
        rotation_to_axis_angle(turns),
        lengths,
        thicknesses,
        body.log_scale.detach(),
        body.shift.detach(),
    )
    seen = move_pelvises(found, result.observation.lens, pelvis)
    ellipbody = replace(
        result,
        parameters=seen,
        before_outline=None,
        energy={name: float(term.detach()) for name, term in terms.items()} or result.energy,
        stage_seconds=result.stage_seconds | {"mesh": seconds},
    )
    moved = ellipbody.posed.joints[:, 0] - pelvis
    registered = ungrown(body.model, shape, rotations, translation + moved, terms)
    return MeshFit(result, registered, ellipbody, bounded(body.clothes.detach()))


class _Body:
    """A detailed body's unknowns, from those of an EllipBody on."""

    def __init__(self, model: DetailedModel, start: BodyParameters, shape: torch.Tensor) -> None:
        self.model, self._start = model, start
        self._rotations, self.translation = pose_from_ellipbody(model, start.posed(), shape, trunk_along=True)
        self.joints = free_joints(model)
        self.turns = shape.new_zeros(1, len(self.joints), 3).requires_grad_()
        self.shape = shape.clone().requires_grad_()
        self.clothes = shape.new_zeros(1, len(CLOTHED)).requires_grad_()
        self.log_scale, self.shift = (each.clone().requires_grad_() for each in (start.log_scale, start.shift))

    def rotations(self) -> torch.Tensor:
        """Of all joints, shape (1, J, 3, 3)."""
        return turn_joints(self._rotations, self.joints, self.turns)

    def parameters(self) -> BodyParameters:
        """Numbers by which the camera sees it."""
        return replace(self._start, log_scale=self.log_scale, shift=self.shift)


class _MeshEnergy:
    """Terms of the mesh stage, of one body."""

    def __init__(self, body: _Body, seen: Observation, said: Uncertainty | None, options: MeshOptions) -> None:
        self._body, self._seen, self._options = body, seen, options
        whole = body.model
        self._drawn, mesh, self._dress = _drawn_mesh(whole, options.vertices)
        known = {place: name for place, name in enumerate(_points_of(whole, seen)) if name is not None}
        places = torch.tensor(list(known), dtype=torch.int64, device=body.shape.device)
        self._points, self._votes = seen.points[places], landmark_votes(seen)[places]
        self._weights = self._drawn.weights_of([*known.values(), *JOINT_NAMES])
        self._first_shape = body.shape.detach().clone()
        self._depths = self._depths_of(self._pose()[1]).detach()
        if said is None:
            self._depth_spreads = torch.full_like(self._depths, _DEPTH_SPREAD)
            self._turn_spreads = torch.full_like(body.turns[..., 0], _TURN_SPREAD)
        else:
            stated = {0: said.turns[:, 0]} | {
                whole.part_joints[part]: said.turns[:, 1 + place] for place, part in enumerate(FREE_PARTS)
            }
            locked = torch.full_like(said.turns[:, 0], _LOCKED_SPREAD)
            self._depth_spreads = said.depths
            self._turn_spreads = torch.stack([stated.get(joint, locked) for joint in body.joints], dim=1)
        self._target: torch.Tensor | None = None
        if seen.labels is not None and seen.label_set is not None and options.seg > 0:
            self._mesh = mesh.relabel(seen.label_set.part_groups)
            self._target = resize_nearest(seen.labels, options.size)[None]
            # Of one group, nothing that shows hides something else.
            self._depth_weight = options.depth_weight if seen.label_set.num_groups > 1 else 0.0

    def __call__(self) -> dict[str, torch.Tensor]:
        """Weighted terms by name, shape (1,) each."""
        body, options, lens = self._body, self._options, self._seen.lens
        posed, points = self._pose()
        marks = points[:, : len(self._points)]
        camera, pelvis = find_camera(body.parameters(), lens, REFERENCE_SIZE)
        away = 0.0 if pelvis is None else pelvis[:, None]
        apart = camera.project(marks + away)[..., :2] - (self._points + 1) * (REFERENCE_SIZE / 2)
        moved = (self._depths_of(points) - self._depths) / self._depth_spreads
        terms = {
            "proj": options.proj * (apart.abs().sum(-1) * self._votes).sum(1),
            "depth": options.depth * moved.square().sum(1),
            "turns": options.turns * (body.turns.square().sum(-1) / self._turn_spreads.square()).sum(1),
            "shape": options.shape / 2 * (body.shape - self._first_shape).square().sum(1),
        }
        if options.clothes is not None:
            terms["clothes"] = options.clothes / 2 * (body.clothes / SPREAD).square().sum(1)
        if self._target is not None:
            size = options.size
            camera, _ = find_camera(body.parameters(), lens, size)
            loss, _ = mesh_label_loss(
                posed.vertices + away,
                self._mesh,
                camera,
                self._target,
                gradient=options.gradient,
                max_distance=options.max_distance,
                depth_weight=self._depth_weight,
                validate=False,
            )
            terms["seg"] = options.seg * (REFERENCE_SIZE / size) ** 2 * loss
        return terms

    def _pose(self) -> tuple[Detailed, torch.Tensor]:
        """The mesh that is drawn, and landmarks, the pelvis about the origin."""
        body = self._body
        dress = None
        if self._options.clothes is not None:
            dress = clothes_offsets(self._dress, body.clothes)
        posed = self._drawn.pose(body.shape, body.rotations(), body.translation, offsets=dress)
        return posed, self._weights @ torch.cat([posed.vertices, posed.joints], dim=1)

    @staticmethod
    def _depths_of(points: torch.Tensor) -> torch.Tensor:
        """Of ``JOINT_NAMES`` but the pelvis, relative to it [m], shape (1, 20)."""
        depths = points[:, -len(JOINT_NAMES) :, 2]
        return depths[:, 1:] - depths[:, :1]


def _points_of(model: DetailedModel, seen: Observation) -> list[str | None]:
    """The model's landmark for each keypoint; None where it has none."""
    own = set(model.landmark_names)
    choices = zip(seen.body_points, seen.landmarks, strict=True)
    return [next((name for name in names if name in own), None) for names in choices]


@lru_cache(maxsize=4)
def _drawn_mesh(model: DetailedModel, vertices: int) -> tuple[DetailedModel, PartMesh, torch.Tensor]:
    with torch.inference_mode(False):  # kept for calls outside of it, too
        basis = clothes_basis(model)
        if model.num_vertices <= vertices:
            return model, detailed_mesh(model), basis
        reduced = reduce_model(model, vertices)
        # Vertices that carry landmarks alone stay at the body.
        others = reduced.model.num_vertices - reduced.drawn
        basis = torch.nn.functional.pad(basis[:, reduced.kept], (0, 0, 0, others))
        return reduced.model, detailed_mesh(reduced.model), basis
