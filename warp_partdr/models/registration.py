"""Registration: shape and pose in which a detailed model clothes EllipBody (paper, section 3.3, eq. 16 to 18).

The detailed model takes EllipBody's pose, and a shape whose bones have EllipBody's lengths. Then Adam refines shape,
turns of the parts and position together, all bodies of a batch side by side. Where EllipBody's lengths and thicknesses
are none of the model's people, parts grow. ``docs/explanation/registration.md`` has the formulas.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch

from ..body.posing import Posed
from ..body.template import BONE_STARTS, JOINT_NAMES, LENGTH_NAMES, NUM_PARTS
from ..errors import check_type
from ..interop.adam import Adam, descend
from ..interop.checks import check_numbers, check_steps, check_tensor
from ..interop.device_cache import device_cache
from ..interop.movable import Movable
from ..interop.torch_threads import one_torch_thread
from .clothes import clothes_basis, clothes_offsets
from .growth import MEASURES, UNGROWN, Growth
from .joint_turns import turn_joints
from .model import Detailed, DetailedModel
from .pose import free_joints, pose_from_ellipbody
from .surfaces import PartCells, registration_costs, surface_samples, vertex_parts

# Where joints are compared: not at the neck, which in a detailed model is the middle of the shoulders and moves along.
MATCHED_JOINTS: tuple[str, ...] = tuple(name for name in JOINT_NAMES if name != "neck")
# Measures within so many standard deviations of natural people's are noise more than growth.
_NATURAL = 2.0
# The same after an edit, as a logarithm: what is special about the person is known then.
_KNOWN = 0.02
_MOST_GROWTH = 1.0  # of a measure's logarithm
_RATES = (0.1, 0.1 * 0.2, 0.1 * 0.05)  # of Adam, for shape values, turns [rad] and position [m]
_SEARCH_EVERY = 5  # steps after which closest points are looked for again
REACH = 0.15  # [m]: distance beyond which there is no closest point
SCALE = 0.03  # [m]: distance from which on closest points count less and less (Geman and McClure)
_LENGTH_PRIOR, _LENGTH_STEPS = 1e-5, 4  # weight of the shape values' squares [m²], and Gauss and Newton's steps
_CENTIMETRES = 1e4  # square metres to square centimetres


@dataclass(frozen=True)
class RegistrationWeights:
    """Weights of the loss's terms, which ``docs/explanation/registration.md`` defines; distances count in centimetres.

    The defaults are for ellipsoids that match a person's outlines, so that half of the skin is inside, and whose
    thicknesses are known: measured or edited.

    Attributes:
        joints: Distance between the model's joints and EllipBody's.
        icp: Distance between the surfaces, both ways.
        penetration: Eq. 18.
        measures: Lengths and thicknesses of the body against EllipBody's.
        thinner: True also counts thicknesses where EllipBody is thinner than the model. It is False for ellipsoids
            within a body.
        shape: Square of the shape values.
        pose: Square of the turns from EllipBody's pose [rad].

    Examples:
        >>> from warp_partdr import RegistrationOptions, RegistrationWeights
        >>> options = RegistrationOptions(RegistrationWeights(pose=5.0))  # joints may turn farther from EllipBody's
        >>> options.weights.pose, options.weights.joints
        (5.0, 5.0)
        >>> RegistrationWeights.fitted().measures  # the ellipsoids of a fit, whose thicknesses are rough
        0.0
    """

    joints: float = 5.0
    icp: float = 0.5
    penetration: float = 10.0
    measures: float = 30.0
    shape: float = 0.5
    pose: float = 20.0
    thinner: bool = True

    @classmethod
    def fitted(cls) -> RegistrationWeights:
        """Weights for a fit's ellipsoids, of which single thicknesses, such as hands', are rough."""
        return cls(icp=2.0, measures=0.0)

    @classmethod
    def inscribed(cls) -> RegistrationWeights:
        """Weights for ellipsoids that lie within the body, as the paper has them."""
        return cls(icp=1.0, penetration=2000.0, shape=0.05, thinner=False)


@dataclass(frozen=True)
class RegistrationOptions:
    """Options of a registration.

    Attributes:
        weights: Weights of the loss's terms.
        iterations: Number of steps of Adam.
        growth: True lets parts grow beyond what the model's shape values reach. By default they grow only with a
            ``start``, after an edit: people are within the model's reach, and what is not is mostly a fit's error.

    Examples:
        >>> from warp_partdr import BodyParameters, RegistrationOptions, RegistrationWeights, anny, register
        >>> options = RegistrationOptions(RegistrationWeights.fitted(), iterations=20)
        >>> register(BodyParameters.mean(1).posed(), anny(), options=options).shape.shape
        torch.Size([1, 20])
    """

    weights: RegistrationWeights = field(default_factory=RegistrationWeights)
    iterations: int = 80
    growth: bool | None = None


@dataclass(frozen=True)
class Registered(Movable):
    """Detailed bodies that clothe EllipBodies.

    Attributes:
        model: Model of the bodies.
        shape: Shape values, shape (B, S).
        rotations: Local rotation of each joint, shape (B, J, 3, 3).
        translation: Position of the root joint [m], shape (B, 3).
        stretches: Stretch of each part at rest, shape (B, 20, 3, 3).
        growth: Factors of ``MEASURES`` that are in the stretches, shape (B, 27).
        unexplained: Logarithm of the factor between each measure of EllipBody and of the body, shape (B, 27).
        detailed: Posed bodies, in EllipBody's frame.
        losses: Weighted terms of the loss at the end, by name, each of shape (B,).

    Examples:
        >>> from warp_partdr import BodyParameters, Registered, RegistrationOptions, anny, register
        >>> posed = BodyParameters.mean(1).posed()
        >>> body: Registered = register(posed, anny(), options=RegistrationOptions(iterations=20))
        >>> body.shape.shape, body.rotations.shape
        (torch.Size([1, 20]), torch.Size([1, 104, 3, 3]))
        >>> again = body.model.pose(body.shape, body.rotations, body.translation)
        >>> again.vertices.shape
        torch.Size([1, 13718, 3])
    """

    model: DetailedModel
    shape: torch.Tensor
    rotations: torch.Tensor
    translation: torch.Tensor
    stretches: torch.Tensor
    growth: torch.Tensor
    unexplained: torch.Tensor
    detailed: Detailed
    losses: dict[str, torch.Tensor]

    def rest(self) -> Detailed:
        """Bodies at rest, where the model has its origin."""
        return self.model.rest(self.shape, stretches=self.stretches)

    def clothed(self, thicknesses: torch.Tensor) -> Detailed:
        """Pose the bodies in clothes; the bodies themselves stay without.

        Args:
            thicknesses: Thickness of the clothes on each of the parts ``CLOTHED`` [m], shape (B, 8).
        """
        offsets = clothes_offsets(clothes_basis(self.model), thicknesses)
        where = self.shape, self.rotations, self.translation
        return self.model.pose(*where, offsets=offsets, stretches=self.stretches)

    def moved(self, by: torch.Tensor) -> Registered:
        """Copy of the bodies, moved by an offset each, shape (B, 3) [m]."""
        return replace(self, translation=self.translation + by, detailed=self.detailed.moved(by))

    def split(self) -> list[Registered]:
        """Each of the bodies alone, B = 1, which takes less time than to select one after the other."""
        tensors = self.shape, self.rotations, self.translation, self.stretches, self.growth, self.unexplained
        rows = [tensor.split(1) for tensor in tensors]
        losses = {name: loss.split(1) for name, loss in self.losses.items()}
        found: list[Registered] = []
        for index, detailed in enumerate(self.detailed.split()):
            shape, rotations, translation, stretches, growth, unexplained = [row[index] for row in rows]
            own = {name: loss[index] for name, loss in losses.items()}
            found.append(
                Registered(self.model, shape, rotations, translation, stretches, growth, unexplained, detailed, own)
            )
        return found

    def select(self, index: torch.Tensor | slice) -> Registered:
        """Select some of the bodies, by an index tensor or a slice."""
        return Registered(
            self.model,
            self.shape[index],
            self.rotations[index],
            self.translation[index],
            self.stretches[index],
            self.growth[index],
            self.unexplained[index],
            self.detailed.select(index),
            {name: loss[index] for name, loss in self.losses.items()},
        )


@one_torch_thread()
def register(
    posed: Posed,
    model: DetailedModel,
    *,
    start: Registered | None = None,
    options: RegistrationOptions | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Registered:
    """Find the detailed bodies that clothe EllipBodies.

    Args:
        posed: B EllipBodies, float32, in any frame. ``FitResult.posed`` is in the camera's.
        model: Model to register, on the same device, float32.
        start: Registration of the same bodies before an edit. Shapes start there, and what EllipBody did not explain
            about these people stays. By default, shapes start with EllipBody's bone lengths.
        options: Weights, iterations and so on.
        progress: Function that is told the stage, the iterations done, and their total number.

    Raises:
        ValueError: If ``posed`` is not float32 or not where the model is, or holds NaN, infinity or what
            is no rotation.

    Examples:
        >>> from warp_partdr import BodyParameters, anny, register
        >>> registered = register(BodyParameters.mean(1).posed(), anny())
        >>> registered.detailed.vertices.shape
        torch.Size([1, 13718, 3])
    """
    check_type("posed", posed, Posed, "of pose, or FitResult.posed")
    check_type("model", model, DetailedModel, "of load_model, or anny()")
    check_type("start", start, Registered | None, "of register")
    check_type("options", options, RegistrationOptions | None, "such as RegistrationOptions()")
    options = options or RegistrationOptions()
    iterations = check_steps(options.iterations, _RATES[0])
    like = model.rest_vertices
    check_tensor("joints", posed.joints, (None, 21, 3), dtypes=(torch.float32,))
    if like.dtype != torch.float32 or posed.joints.device != like.device:
        raise ValueError(
            f"posed: {posed.joints.dtype} on {posed.joints.device}; expected float32 on {like.device}, as the model"
        )
    batch = len(posed.joints)
    sizes = {"joints": (21, 3), "rotations": (20, 3, 3), "centres": (20, 3), "axes": (20, 3, 3), "semi_axes": (20, 3)}
    for name, size in sizes.items():
        check_tensor(name, getattr(posed, name), (batch, *size), dtypes=(torch.float32,), like=("joints", posed.joints))
    check_numbers(vars(posed), rotations=("rotations",), frames=("axes",), positive=("semi_axes",))
    posed = Posed(*(tensor.detach().contiguous() for tensor in vars(posed).values()))
    shape = shape_from_lengths(model, posed) if start is None else start.shape.detach().clone()
    pose, translation = pose_from_ellipbody(model, posed, shape)
    free = torch.tensor(free_joints(model), device=like.device)
    turns = like.new_zeros(len(shape), len(free), 3)
    loss = _Loss(model, posed, options.weights)
    measures = _MeasureLoss(model, posed, options, shape, start)

    unknowns = [shape.requires_grad_(), turns.requires_grad_(), translation.requires_grad_()]
    adam = Adam(([tensor], rate) for tensor, rate in zip(unknowns, _RATES, strict=True))

    def posed_model(*, stretched: bool) -> tuple[torch.Tensor, Detailed]:
        rotations = turn_joints(pose, free, turns)
        stretches = measures.stretches if stretched else None
        return rotations, model.pose(shape, rotations, translation, stretches=stretches)

    def terms(detailed: Detailed) -> dict[str, torch.Tensor]:
        return {**loss(detailed, shape, turns), "measures": measures(shape)}

    def step(iteration: int, share: float) -> None:
        searching = iteration % _SEARCH_EVERY == 0
        if searching:
            measures.grow(shape.detach())
        _, detailed = posed_model(stretched=measures.stretched)
        if searching:
            loss.search(detailed.vertices.detach())
        torch.stack(list(terms(detailed).values())).sum().backward()
        adam.step(share)

    def tell(done: int) -> None:
        if progress is not None:
            progress("registration", done, iterations)

    descend(step, iterations, last_share=0.0, progress=tell)
    with torch.no_grad():
        rotations, detailed = posed_model(stretched=True)
        loss.search(detailed.vertices)
        return Registered(
            model,
            shape=shape.detach(),
            rotations=rotations,
            translation=translation.detach(),
            stretches=measures.stretches,
            growth=measures.logs.exp(),
            unexplained=measures.differences(shape) - measures.logs,
            detailed=detailed,
            losses=terms(detailed),
        )


def ungrown(
    model: DetailedModel,
    shape: torch.Tensor,
    rotations: torch.Tensor,
    translation: torch.Tensor,
    losses: dict[str, torch.Tensor],
) -> Registered:
    """Detailed bodies found otherwise, with no part grown, as ``Registered`` to the EllipBodies measured from them."""
    growth = shape.new_ones(len(shape), len(MEASURES))
    stretches = torch.eye(3, dtype=shape.dtype, device=shape.device).expand(len(shape), NUM_PARTS, 3, 3)
    detailed = model.pose(shape, rotations, translation)
    losses = {name: loss.detach() for name, loss in losses.items()}
    return Registered(
        model, shape, rotations, translation, stretches, growth, torch.zeros_like(growth), detailed, losses
    )


def shape_from_lengths(model: DetailedModel, posed: Posed) -> torch.Tensor:
    """Shape values, shape (B, S), whose bones at rest have EllipBody's lengths (Gauss and Newton's method).

    Joints at rest are linear in the shape.
    """
    bones, changes = _bones_at_rest(model)
    targets = 2 * posed.semi_axes[..., 0]
    shape = bones.new_zeros(len(targets), model.num_shapes)
    regular = _LENGTH_PRIOR * torch.eye(model.num_shapes, dtype=shape.dtype, device=shape.device)
    for _ in range(_LENGTH_STEPS):
        now = bones + torch.einsum("bs,skc->bkc", shape, changes)
        lengths = now.norm(dim=-1)
        slopes = torch.einsum("bkc,skc->bks", now / lengths[..., None], changes)
        aims = targets - lengths + (slopes @ shape[..., None])[..., 0]
        products, wanted = slopes.mT @ slopes + regular, slopes.mT @ aims[..., None]
        # ``solve`` would wait for the device, to tell of singular matrices, which these can't be.
        shape = torch.linalg.solve_ex(products, wanted).result[..., 0]
    return shape


@device_cache(8)  # a product with the whole model
def _bones_at_rest(model: DetailedModel) -> tuple[torch.Tensor, torch.Tensor]:
    """EllipBody's bones [m], shape (20, 3), and their changes by a unit of each shape value, shape (S, 20, 3)."""
    with torch.inference_mode(False):  # kept for calls outside of it, too
        weights = model.weights_of(JOINT_NAMES)
        joints = weights @ torch.cat([model.rest_vertices, model.rest_joints])
        moves = weights @ torch.cat([model.shape_directions, model.joint_directions], dim=1)
        return joints[1:] - joints[BONE_STARTS], moves[:, 1:] - moves[:, BONE_STARTS]


class _Loss:
    """L_ICP + L_PEN and the priors, each of shape (B,), for bodies near their EllipBodies."""

    def __init__(self, model: DetailedModel, posed: Posed, weights: RegistrationWeights) -> None:
        self.posed, self.weights = posed, weights
        self.joint_weights = model.weights_of(MATCHED_JOINTS)
        self.joints = posed.joints[:, [JOINT_NAMES.index(name) for name in MATCHED_JOINTS]]
        self.parts, self.areas = vertex_parts(model)
        self.cells = PartCells(model, self.areas > 0, len(posed.joints))
        self.samples, self.sample_weights = surface_samples(posed)
        self.corners = torch.empty(0)

    def search(self, vertices: torch.Tensor) -> None:
        """Find the closest points of the mesh to the samples."""
        corners, places, found = self.cells.closest(vertices, self.samples, self.sample_weights, REACH)
        batch = torch.arange(len(vertices), device=vertices.device)[:, None, None]
        triangles = vertices[batch, corners]
        edges = triangles[..., 1:, :] - triangles[..., :1, :]
        normals = torch.nn.functional.normalize(torch.linalg.cross(edges[..., 0, :], edges[..., 1, :]), dim=-1)
        squares = ((triangles * places[..., None]).sum(-2) - self.samples).square().sum(-1)
        share = 1 / (1 + squares / SCALE**2)
        self.corners, self.places, self.normals = corners, places, normals
        self.icp_weights = self.sample_weights * found * share.square()

    def __call__(self, detailed: Detailed, shape: torch.Tensor, turns: torch.Tensor) -> dict[str, torch.Tensor]:
        weights = self.weights
        points = torch.cat([detailed.vertices, detailed.joints], dim=1)
        joints = (self.joint_weights @ points - self.joints).square().sum(-1).mean(-1)
        batch = torch.arange(len(shape), device=shape.device)[:, None, None]
        nearest = (detailed.vertices[batch, self.corners] * self.places[..., None]).sum(-2)
        squares = ((nearest - self.samples) * self.normals).sum(-1).square()
        to_mesh = (self.icp_weights * squares).sum(-1)
        icp = _CENTIMETRES * weights.icp
        to_ellipsoids, penetration = registration_costs(detailed.vertices, self.parts, self.areas, self.posed, SCALE)
        return {
            "joints": _CENTIMETRES * weights.joints * joints,
            "icp_to_mesh": icp * to_mesh,
            "icp_to_ellipsoids": icp * to_ellipsoids,
            "penetration": weights.penetration * penetration,
            "shape": weights.shape * shape.square().mean(-1),
            "pose": weights.pose * turns.square().sum(-1).mean(-1),
        }


class _MeasureLoss:
    """Loss of lengths and thicknesses against EllipBody's, and growth of parts where no shape of the model has them.

    A measure whose logarithm is off by r adds log(1 + r² / d²), d being the spread over natural people: a Cauchy
    distribution, so that large differences do not draw the shape far. The residual that such a robust fit gives up,
    r³ / (r² + d²), is growth.
    """

    def __init__(
        self,
        model: DetailedModel,
        posed: Posed,
        options: RegistrationOptions,
        shape: torch.Tensor,
        start: Registered | None,
    ) -> None:
        self.options = options
        self.grows = start is not None if options.growth is None else options.growth
        self.stretched = self.grows or start is not None  # else all stretches are the identity, and need no time
        self.body = Growth(model, shape.detach())
        self.demanded = self.body.demanded(posed.semi_axes)
        self.spreads = _NATURAL * self.body.spreads
        self.outward = torch.zeros(len(MEASURES), dtype=torch.bool, device=shape.device)
        self.growing = torch.tensor([name not in UNGROWN for name in MEASURES], device=shape.device)
        self.logs = torch.zeros_like(self.demanded)
        if start is not None:
            self.demanded = self.demanded - start.unexplained
            self.spreads = torch.full_like(self.spreads, _KNOWN)
            self.logs = start.growth.log()
        elif not options.weights.thinner:
            self.outward[len(LENGTH_NAMES) :] = True
        self.stretches = self.body.stretches(self.logs.exp())

    def __call__(self, shape: torch.Tensor) -> torch.Tensor:
        """Loss, shape (B,)."""
        squares = (self._kept(self.differences(shape)) / self.spreads).square()
        return self.options.weights.measures * squares.log1p().mean(-1)

    def differences(self, shape: torch.Tensor) -> torch.Tensor:
        """Logarithms of EllipBody's measures over those of the model without growth, shape (B, 27)."""
        return self.demanded - self.body.measured(shape)

    def grow(self, shape: torch.Tensor) -> None:
        """Renew growth and stretches."""
        if not self.grows:
            return
        has = self.body.measured(shape)
        off = self._kept(self.demanded - has)
        target = off**3 / (off.square() + self.spreads.square())
        # A part's stretch changes a little less than its measure, and its neighbours' too.
        got = self.body.measured(shape, self.stretches) - has
        self.logs = self.growing * (self.logs + target - got).clamp(-_MOST_GROWTH, _MOST_GROWTH)
        self.stretches = self.body.stretches(self.logs.exp())

    def _kept(self, differences: torch.Tensor) -> torch.Tensor:
        return torch.where(self.outward, differences.clamp(min=0), differences)
