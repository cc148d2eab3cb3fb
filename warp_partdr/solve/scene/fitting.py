"""Fit of a scene: all people in all frames before all cameras, in one refinement."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch

from ...body.template import JOINT_NAMES
from ...errors import check_type
from ...inputs.scene import Ground, Scene
from ...interop.devices import choose_device
from ...interop.gradient_mode import with_gradients
from ...interop.movable import Movable
from ...interop.torch_threads import one_torch_thread
from ...models.anny import anny
from ...models.clothes import bounded
from ...models.measuring import statures
from ...models.model import DetailedModel
from ...models.registration import Registered, ungrown
from ...models.resizing import resize_before
from ..ellipsoids.stages import Progress
from ..mesh.observed_body import ObservedBody
from ..mesh.starts import StandingFeet, Starts
from ..mesh.steps import RefinedPeople, refine_starts
from .clip_sizes import of_one_size
from .depth_order import LEAST_GAIN, exchange, order_people
from .ground import Grounded, stand_on_ground
from .impossible import impossible_people
from .looks import look_at
from .options import SceneOptions
from .plan import ScenePlan, plan_scene
from .start import gather_scene


@dataclass(frozen=True)
class SceneFit(Movable):
    """Bodies of a scene.

    Attributes:
        scene: What was given.
        bodies: Detailed bodies in the world, N = P T, frames of a person in a row.
        clothes: Thicknesses of clothes and hair of each person [m], shape (P, 8).
        energy: Weighted terms before the last step, by name.
        seconds: Wall time of each stage.
        ground: That people stand on, where one was found.
        warnings: Faults of sights and cameras that were found, a sentence each.
    """

    scene: Scene
    bodies: Registered
    clothes: torch.Tensor
    energy: dict[str, float]
    seconds: dict[str, float]
    warnings: tuple[str, ...]
    ground: Ground | None = None

    @property
    def joints(self) -> torch.Tensor:
        """``JOINT_NAMES`` in the world [m], shape (P, T, 21, 3)."""
        return self.landmarks(JOINT_NAMES)

    @property
    def vertices(self) -> torch.Tensor:
        """Vertices of the bodies without clothes, in the world [m], shape (P, T, V, 3)."""
        return self._by_person(self.bodies.detailed.vertices)

    @property
    def statures(self) -> torch.Tensor:
        """Heights of the people standing [m], shape (P,)."""
        return statures(self.bodies.model, self.bodies.shape[:: self.scene.num_frames])

    def landmarks(self, names: tuple[str, ...]) -> torch.Tensor:
        """Landmarks in the world [m], shape (P, T, L, 3)."""
        return self._by_person(self.bodies.model.landmarks(self.bodies.detailed, names))

    def _by_person(self, values: torch.Tensor) -> torch.Tensor:
        return values.unflatten(0, (self.scene.num_people, self.scene.num_frames))


@one_torch_thread()
@with_gradients()
def fit_scene(
    scene: Scene,
    *,
    options: SceneOptions | None = None,
    model: DetailedModel | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
    looks: Sequence[ObservedBody] | None = None,
) -> SceneFit:
    """Fit detailed bodies to a scene: one shape a person, a pose a frame, places in the world.

    The label network looks at each sight. Where several views see a person, its turns are averaged and pelvises lie
    where rays meet. All is refined together: keypoints and labels of every picture, people drawn with one another,
    depth and turns held as sure as the network was, moves smooth in time.

    Args:
        scene: Views and sights.
        options: Weights, iterations and sizes.
        model: On the device, float32; default Anny.
        device: "cpu" or a CUDA device.
        progress: Called with (stage name, iterations done, iterations in all).
        looks: Of ``look_at`` on the same device, where somebody looked already or starts otherwise.

    Raises:
        InputError: If a sight has no keypoint, people who overlap have more than 254
            labels, or a stature is of several people or before several cameras.
        ValueError: If a known shape is of another model, or the ground is known and ``options.ground`` 0.
        TypeError: If an argument is of another type.
    """
    check_type("scene", scene, Scene, "such as Scene(views, sights)")
    check_type("options", options, SceneOptions | None, "such as SceneOptions()")
    check_type("model", model, DetailedModel | None, "of load_model, or anny()")
    options = options or SceneOptions()
    options.check_sights(scene.num_people, len(scene.views))
    if scene.ground is not None and not options.ground:
        raise ValueError("options.ground: 0, of a scene whose ground is known; expected its weight, such as 0.1")
    where = torch.device(choose_device(str(device)))
    model = model or anny(where)
    tell = progress or (lambda name, done, total: None)
    started = time.perf_counter()
    if looks is None:
        tell("network", 0, 1)
        looks = look_at(scene, where)
    plan = plan_scene(scene, looks, model, options)
    with torch.no_grad():
        if options.one_size or options.stature is not None:
            looks = of_one_size(model, scene, looks, options.stature)
        looks, grounded = stand_on_ground(plan, looks)
    warnings = _warnings(looks)
    looked = time.perf_counter()
    best = _refine(plan, looks, grounded, lambda done: tell("scene", done, options.mesh.iterations))
    with torch.no_grad():
        drawn, pelvises = plan.energy.drawn, plan.energy.place(best.people, best.unknowns).pelvises
        assert pelvises is not None
        shape, rotations, translation = drawn.whole_pose(model, best.people, best.unknowns)
        positions = translation + pelvises
        if options.stature is not None:
            first, positions = resize_before(model, shape[:1], positions, options.stature, scene.views[0].eye)
            shape = first.expand_as(shape)
        bodies = ungrown(model, shape, rotations, positions, {})
        clothes = bounded(best.unknowns.clothes)
    seconds = {"network": looked - started, "scene": time.perf_counter() - looked}
    ground = None if grounded is None else grounded.ground
    fit = SceneFit(scene, bodies, clothes, best.energies, seconds, warnings, ground)
    return replace(fit, warnings=(*warnings, *_impossible(fit)))


def _held(people: Starts, grounded: Grounded | None) -> Starts:
    """People whose feet are held to the ground, if there is one."""
    if grounded is None:
        return people
    plane = people.shape.new_tensor([*grounded.ground.normal, grounded.ground.offset])
    return replace(people, feet=StandingFeet(plane, people.shape.new_tensor(grounded.shares)))


def _refine(
    plan: ScenePlan, looks: Sequence[ObservedBody], grounded: Grounded | None, progress: Callable[[int], None]
) -> RefinedPeople:
    """People in the best of the orders in depth that are tried."""
    options, scene = plan.options, plan.scene
    with torch.no_grad():
        people, looks = order_people(plan, looks) if options.exchanges else (gather_scene(plan, looks), looks)
    best = refine_starts(plan.energy, _held(people, grounded), progress)
    # What is refined fits the order it stands in, so in one frame the other order is refined, too, before they compare.
    least_gain = LEAST_GAIN if scene.num_frames > 1 else -math.inf
    for _ in range(1, scene.num_people if options.exchanges else 1):
        with torch.no_grad():
            exchanged = exchange(plan, best.people, best.unknowns, looks, least_gain)
            if exchanged is None:
                break
            people = gather_scene(plan, exchanged)
        other = refine_starts(plan.energy, _held(people, grounded), progress)
        if sum(other.energies.values()) >= sum(best.energies.values()):
            break
        best, looks = other, exchanged
    return best


def _impossible(fit: SceneFit) -> list[str]:
    """Warnings of people before several views who are no people."""
    if len(fit.scene.views) == 1:
        return []
    eyes = torch.stack([view.eye.cpu() for view in fit.scene.views])
    places = fit.landmarks(("pelvis",))[:, :, 0].cpu()
    far = (places[:, :, None] - eyes.to(places)).norm(dim=-1).mean(1).amax(1).tolist()
    return impossible_people(dict(enumerate(fit.statures.tolist())), dict(enumerate(far)))


def _warnings(looks: Sequence[ObservedBody]) -> tuple[str, ...]:
    """Faults of sights, each sentence once, with the first sight that it is about."""
    first: dict[str, str] = {}
    for look in looks:
        for warning in look.evidence.warnings:
            first.setdefault(warning, f"person {look.sight.person}, frame {look.sight.frame}, view {look.sight.view}")
    return tuple(f"{where}: {warning}" for warning, where in first.items())
