"""Plan of a scene's fit: the people who are drawn together, and the energy of all people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ...inputs.scene import Scene
from ...interop.device_cache import device_cache
from ...models.capsules import measure_capsules
from ...models.model import DetailedModel
from ..mesh.drawn_model import DrawnModel, draw_model
from ..mesh.energy import MeshEnergy
from ..mesh.feet import FEET
from ..mesh.observed_body import ObservedBody
from .clusters import Clusters, check_room, find_clusters
from .options import SceneOptions


@dataclass(frozen=True, eq=False)
class ScenePlan:
    """Scene with all that its fit needs.

    Attributes:
        scene: The scene.
        model: The whole detailed model.
        options: Options of the fit.
        clusters: Clusters of people who are drawn together.
        energy: Energy of all people.
    """

    scene: Scene
    model: DetailedModel
    options: SceneOptions
    clusters: Clusters
    energy: MeshEnergy


def plan_scene(
    scene: Scene, observed_bodies: Sequence[ObservedBody], model: DetailedModel, options: SceneOptions
) -> ScenePlan:
    """Finds the people who are drawn together, and makes the energy.

    Args:
        scene: The scene.
        observed_bodies: Bodies that ``observe_scene`` returns.
        model: The whole detailed model.
        options: Options of the fit.

    Raises:
        InputError: If people who overlap have more labels than a picture holds.
    """
    label_set = next(
        (observed.observation.label_set for observed in observed_bodies if observed.observation.label_set is not None),
        None,
    )
    drawn = draw_model(model, options.mesh, label_set)
    clusters = find_clusters(observed_bodies, scene.num_people)
    groups = 0 if label_set is None else label_set.num_groups
    if drawn.mesh is not None:
        check_room(clusters, groups)
    energy = _scene_energy(drawn, options, scene.num_people, max(map(len, clusters)), groups)
    return ScenePlan(scene, model, options, clusters, energy)


@device_cache(8)
def _scene_energy(drawn: DrawnModel, options: SceneOptions, people: int, most: int, groups: int) -> MeshEnergy:
    """Energy of ``people`` people, of whom a cluster has at most ``most``, with labels of G groups.

    The last ones are cached, because an energy with equal arguments is the same.
    """
    apart = options.apart if people > 1 else options.mesh.apart
    cluster_mesh = None
    if drawn.mesh is not None and most > 1:
        cluster_mesh = drawn.mesh.repeated(most, groups, drawn.first or drawn.model.num_vertices)
    return MeshEnergy(
        drawn,
        options.mesh,
        cluster_mesh,
        measure_capsules(drawn.model) if apart > 0 else None,
        torch.tensor([drawn.model.landmark_names.index(name) for name in FEET], device=drawn.ends.device),
        apart,
        options.ground,
        options.sliding,
    )
