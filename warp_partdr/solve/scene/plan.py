"""Plan of a scene's fit: who is drawn together, and the energy of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import torch

from ...inputs.scene import Scene
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
    """Scene with all that its fit works with.

    Attributes:
        scene: The scene.
        model: The whole detailed model.
        options: Options of the fit.
        clusters: People who are drawn together.
        energy: Energy of all people.
    """

    scene: Scene
    model: DetailedModel
    options: SceneOptions
    clusters: Clusters
    energy: MeshEnergy


def plan_scene(scene: Scene, looks: Sequence[ObservedBody], model: DetailedModel, options: SceneOptions) -> ScenePlan:
    """Find who is drawn together, and make the energy.

    Args:
        scene: The scene.
        looks: Of ``look_at``.
        model: The whole detailed model.
        options: Options of the fit.

    Raises:
        InputError: If people who overlap have more labels than a picture holds.
    """
    label_set = next((look.observation.label_set for look in looks if look.observation.label_set is not None), None)
    drawn, clusters = draw_model(model, options.mesh, label_set), find_clusters(looks, scene.num_people)
    groups = 0 if label_set is None else label_set.num_groups
    if drawn.mesh is not None:
        check_room(clusters, groups)
    energy = _scene_energy(drawn, options, scene.num_people, max(map(len, clusters)), groups)
    return ScenePlan(scene, model, options, clusters, energy)


@lru_cache(maxsize=8)
def _scene_energy(drawn: DrawnModel, options: SceneOptions, people: int, most: int, groups: int) -> MeshEnergy:
    """Energy of people, at most so many in a cluster, with labels of G groups; kept, as of ``mesh_energy``."""
    apart = options.apart if people > 1 else options.mesh.apart
    together = None
    if drawn.mesh is not None and most > 1:
        together = drawn.mesh.repeated(most, groups, drawn.first or drawn.model.num_vertices)
    return MeshEnergy(
        drawn,
        options.mesh,
        together,
        measure_capsules(drawn.model) if apart > 0 else None,
        torch.tensor([drawn.model.landmark_names.index(name) for name in FEET], device=drawn.ends.device),
        apart,
        options.ground,
        options.sliding,
    )
