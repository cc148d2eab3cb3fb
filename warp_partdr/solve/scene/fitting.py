"""Fit of a scene: one refinement of all people in all frames and views."""

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
from .clip_sizes import with_one_size
from .depth_order import LEAST_GAIN, exchange, order_people
from .ground import Grounded, stand_on_ground
from .impossible import impossible_people
from .observations import observe_scene
from .options import SceneOptions
from .plan import ScenePlan, plan_scene
from .start import gather_scene


@dataclass(frozen=True)
class SceneFit(Movable):
    """Bodies of a scene.

    Attributes:
        scene: Scene that was fitted.
        bodies: Detailed bodies in the world, N = P T. The frames of a person follow one another.
        clothes: Thicknesses of clothes and hair of each person [m], shape (P, 8).
        energy: Weighted terms of the energy before the last step, by name.
        seconds: Wall time of each stage [s], by name.
        warnings: Warnings about observations and cameras, a sentence each.
        ground: Ground that people stand on. It is None if none was known or found.
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
        """Positions of ``JOINT_NAMES`` in the world [m], shape (P, T, 21, 3)."""
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
        """Positions of landmarks in the world [m], shape (P, T, L, 3)."""
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
    observed_bodies: Sequence[ObservedBody] | None = None,
) -> SceneFit:
    """Fits detailed bodies to a scene: one shape for each person, and a pose and a position for each frame.

    The label network predicts a body for each observation. If several views show a person, the start has the mean of
    the predicted rotations, and its pelvis lies where the views' rays meet. Then everything is refined together. People
    who overlap are drawn with one another, and the keypoints and labels of all pictures are compared. Depths and
    rotations are held near the network's, more so where it is more certain. Motion is smooth in time.

    Args:
        scene: Views and observations.
        options: Weights, iterations and sizes.
        model: Detailed model on the device, float32. The default is Anny.
        device: Device to run on, "cpu" or a CUDA device.
        progress: Function that is called with (stage name, iterations done, all iterations).
        observed_bodies: Bodies that ``observe_scene`` returned on the same device, or other bodies to start from. If it
            is None, ``observe_scene`` is called.

    Raises:
        InputError: If an observation has no keypoint, people who overlap have more than 254 labels, or a stature is
            given for several people or several cameras.
        ValueError: If a known shape belongs to another model, or the ground is known and ``options.ground`` is 0.
        TypeError: If an argument has another type.

    Examples:
        >>> from warp_partdr import Perspective, Scene, SceneObservation, View, fit_scene, read_keypoints
        >>> view = View(Perspective.of_picture((512, 384), focal=600.0))
        >>> scene = Scene([view], [SceneObservation(read_keypoints("keypoints.json")[0])])
        >>> fit_scene(scene).joints.shape  # people, frames, joints, in the world [m]
        torch.Size([1, 1, 21, 3])
    """
    check_type("scene", scene, Scene, "such as Scene(views, observations)")
    check_type("options", options, SceneOptions | None, "such as SceneOptions()")
    check_type("model", model, DetailedModel | None, "of load_model, or anny()")
    options = options or SceneOptions()
    options.check_known_stature(scene.num_people, len(scene.views))
    if scene.ground is not None and not options.ground:
        raise ValueError("options.ground: 0, for a scene whose ground is known; expected its weight, such as 0.1")
    device = torch.device(choose_device(str(device)))
    model = model or anny(device)
    report = progress or (lambda name, done, total: None)
    started = time.perf_counter()
    if observed_bodies is None:
        report("network", 0, 1)
        observed_bodies = observe_scene(scene, device)
    plan = plan_scene(scene, observed_bodies, model, options)
    with torch.no_grad():
        if options.one_size or options.stature is not None:
            observed_bodies = with_one_size(model, scene, observed_bodies, options.stature)
        observed_bodies, grounded = stand_on_ground(plan, observed_bodies)
    warnings = _warnings(observed_bodies)
    network_done = time.perf_counter()
    best = _refine(plan, observed_bodies, grounded, lambda done: report("scene", done, options.mesh.iterations))
    with torch.no_grad():
        drawn = plan.energy.drawn
        pelvises = plan.energy.place(best.people, best.unknowns).pelvises
        assert pelvises is not None
        shape, rotations, translation = drawn.whole_pose(model, best.people, best.unknowns)
        positions = translation + pelvises
        if options.stature is not None:
            first, positions = resize_before(model, shape[:1], positions, options.stature, scene.views[0].eye)
            shape = first.expand_as(shape)
        bodies = ungrown(model, shape, rotations, positions, {})
        clothes = bounded(best.unknowns.clothes)
    seconds = {"network": network_done - started, "scene": time.perf_counter() - network_done}
    ground = None if grounded is None else grounded.ground
    fit = SceneFit(scene, bodies, clothes, best.energies, seconds, warnings, ground)
    return replace(fit, warnings=(*warnings, *_impossible(fit)))


def _held(people: Starts, grounded: Grounded | None) -> Starts:
    """Starts whose standing feet are held to the ground, if there is one."""
    if grounded is None:
        return people
    plane = people.shape.new_tensor([*grounded.ground.normal, grounded.ground.offset])
    return replace(people, feet=StandingFeet(plane, people.shape.new_tensor(grounded.shares)))


def _refine(
    plan: ScenePlan, observed_bodies: Sequence[ObservedBody], grounded: Grounded | None, progress: Callable[[int], None]
) -> RefinedPeople:
    """Refines people in several depth orders, and returns those in the best one."""
    options = plan.options
    scene = plan.scene
    with torch.no_grad():
        if options.exchanges:
            people, observed_bodies = order_people(plan, observed_bodies)
        else:
            people = gather_scene(plan, observed_bodies)
    best = refine_starts(plan.energy, _held(people, grounded), progress)
    # A refined state fits its own order. So if there is only one frame, the other order is refined, too, before the two
    # are compared.
    least_gain = LEAST_GAIN if scene.num_frames > 1 else -math.inf
    for _ in range(1, scene.num_people if options.exchanges else 1):
        with torch.no_grad():
            exchanged = exchange(plan, best.people, best.unknowns, observed_bodies, least_gain)
            if exchanged is None:
                break
            people = gather_scene(plan, exchanged)
        other = refine_starts(plan.energy, _held(people, grounded), progress)
        if sum(other.energies.values()) >= sum(best.energies.values()):
            break
        best = other
        observed_bodies = exchanged
    return best


def _impossible(fit: SceneFit) -> list[str]:
    """Warnings about impossible people, if there are several views; they show that cameras are wrong."""
    if len(fit.scene.views) == 1:
        return []
    eyes = torch.stack([view.eye.cpu() for view in fit.scene.views])
    pelvises = fit.landmarks(("pelvis",))[:, :, 0].cpu()
    distances = (pelvises[:, :, None] - eyes.to(pelvises)).norm(dim=-1).mean(1).amax(1).tolist()
    return impossible_people(dict(enumerate(fit.statures.tolist())), dict(enumerate(distances)))


def _warnings(observed_bodies: Sequence[ObservedBody]) -> tuple[str, ...]:
    """Warnings about observations. Each sentence comes once, with the first observation that it is about."""
    first: dict[str, str] = {}
    for observed in observed_bodies:
        for warning in observed.evidence.warnings:
            position = f"person {observed.person}, frame {observed.frame}, view {observed.view}"
            first.setdefault(warning, position)
    return tuple(f"{position}: {warning}" for warning, position in first.items())
