"""People of a scene who are drawn together: those who overlap, and nobody else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.quick import QUICK_SCENE

from warp_partdr.cameras import Crop
from warp_partdr.inputs.scene import Scene, SceneObservation
from warp_partdr.lab.synthetic.scene_people import make_views
from warp_partdr.models.anny import anny
from warp_partdr.solve.mesh.energy import MeshEnergy
from warp_partdr.solve.mesh.observed_body import ObservedBody
from warp_partdr.solve.mesh.starts import Starts
from warp_partdr.solve.scene.clusters import find_clusters, slots_of
from warp_partdr.solve.scene.fitting import fit_scene
from warp_partdr.solve.scene.observations import observe_scene
from warp_partdr.solve.scene.options import SceneOptions
from warp_partdr.solve.scene.plan import plan_scene
from warp_partdr.solve.scene.start import gather_scene


def beside(
    observation: SceneObservation, person: int, widths: float, *, frame: int = 0, parts: bool = True
) -> SceneObservation:
    """A copy of the person stands so many widths of the box farther to the right."""
    points, seen = observation.keypoints.points, observation.keypoints.visible
    aside = round(widths * 1.3 * float(np.ptp(points[seen, 0])))
    moved = replace(observation.keypoints, points=points + np.float32([aside, 0]))
    labels = observation.parts if parts else None
    if labels is not None:
        groups = np.pad(labels.groups, ((0, 0), (aside, 0)))
        labels = replace(labels, groups=groups)
    return SceneObservation(moved, labels, person, frame)


def line(*widths: float, frame: int = 0) -> list[SceneObservation]:
    one = make_views(3, 1).scene.observations[0]
    return [beside(one, person, far, frame=frame, parts=False) for person, far in enumerate(widths)]


def observe_all(observations: list[SceneObservation]) -> tuple[Scene, list[ObservedBody]]:
    scene = Scene(make_views(3, 1).scene.views, observations)
    return scene, observe_scene(scene, "cpu")


def energy_of(scene: Scene, options: SceneOptions) -> tuple[MeshEnergy, Starts]:
    observed_bodies = observe_scene(scene, "cpu")
    plan = plan_scene(scene, observed_bodies, anny("cpu"), options)
    with torch.no_grad():
        return plan.energy, gather_scene(plan, observed_bodies)


@pytest.mark.parametrize(
    ("widths", "clusters"),
    [
        ((0.0,), ((0,),)),
        ((0.0, 3.0), ((0,), (1,))),
        ((0.0, 0.2), ((0, 1),)),
        ((0.0, 3.0, 0.5, 1.0, 3.2), ((0, 2, 3), (1, 4))),  # 2 overlaps both 0 and 3
    ],
)
def test_who_overlaps_is_drawn_together(widths: tuple[float, ...], clusters: tuple[tuple[int, ...], ...]) -> None:
    scene, observed_bodies = observe_all(line(*widths))
    assert find_clusters(observed_bodies, scene.num_people) == clusters


def test_people_who_meet_in_one_frame_are_drawn_together_in_all() -> None:
    """Two who meet in one of the frames are drawn together in all."""
    scene, observed_bodies = observe_all(line(0.0, 3.0) + line(0.0, 0.2, frame=1))
    assert find_clusters(observed_bodies, scene.num_people) == ((0, 1),)


def test_people_of_other_frames_or_views_do_not_overlap() -> None:
    scene = make_views(3, 2).scene
    one = scene.observations[0]
    for frame, view in ((1, 0), (0, 1)):
        observations = [
            beside(one, 0, 0.0, parts=False),
            replace(beside(one, 1, 0.1, parts=False), frame=frame, view=view),
        ]
        assert find_clusters(observe_scene(replace(scene, observations=observations), "cpu"), 2) == ((0,), (1,))


def test_boxes_are_those_of_the_picture_however_small_labels_are_kept() -> None:
    _, observed_bodies = observe_all(line(0.0, 0.2))
    evidence = replace(observed_bodies[1].evidence, window=Crop(0.0, 0.0, 0.1, (1, 1)))
    assert find_clusters([observed_bodies[0], replace(observed_bodies[1], evidence=evidence)], 2) == ((0, 1),)


def test_a_crowd_in_a_line_is_one_cluster() -> None:
    scene, observed_bodies = observe_all(line(*(0.6 * place for place in range(9))))
    assert find_clusters(observed_bodies, scene.num_people) == (tuple(range(9)),)


def test_everybody_has_a_slot() -> None:
    slots, places = slots_of(((0, 3), (2, 4, 5)), 6, torch.device("cpu"))
    assert slots.tolist() == [[0, 3, -1], [2, 4, 5]]
    assert places.tolist() == [[0, 0], [-1, -1], [1, 0], [0, 1], [1, 1], [1, 2]]


def test_who_stands_apart_is_drawn_as_alone() -> None:
    """Labels, crop and size are those of a scene with one person."""
    scene = make_views(3, 1).scene
    one = scene.observations[0]
    many = replace(scene, observations=[one, beside(one, 1, 4.0, parts=False)])
    targets = []
    for each in (scene, many):
        _, people = energy_of(each, QUICK_SCENE)
        assert people.overlapping is None
        assert people.alone is not None
        targets.append(people.alone.target)
    assert torch.equal(targets[1][:1], targets[0])
    assert bool((targets[1][1] == 255).all())  # of the other there are keypoints alone


def test_more_people_than_labels_are_fitted_where_few_overlap() -> None:
    """20 people, of whom a picture could hold 18: 14 groups each."""
    one = make_views(3, 1).scene
    observations = [beside(one.observations[0], person, 4.0 * person, parts=person % 10 == 0) for person in range(20)]
    fit = fit_scene(replace(one, observations=observations), options=QUICK_SCENE)
    assert fit.joints.shape[0] == 20
    assert bool(fit.joints.isfinite().all())


def seg_of(scene: Scene, options: SceneOptions = QUICK_SCENE) -> float:
    energy, people = energy_of(scene, options)
    with torch.no_grad():
        return energy.factors(people)["seg"] * float(energy(people, people.at_rest())["seg"].sum())


def test_labels_of_all_count_where_some_overlap() -> None:
    """Two who overlap and one who does not cost as much as the two and the one."""
    scene = make_views(3, 1).scene
    one = scene.observations[0]
    pair = [one, beside(one, 1, 0.5, parts=False)]
    third = beside(one, 2, 4.0)
    two, alone, all_ = (
        seg_of(replace(scene, observations=each)) for each in (pair, [replace(third, person=0)], [*pair, third])
    )
    assert min(two, alone) > 0
    assert all_ == pytest.approx(two + alone, rel=1e-4)


def test_the_size_of_pictures_together_does_not_weigh() -> None:
    one = make_views(3, 1).scene
    pair = replace(one, observations=[one.observations[0], beside(one.observations[0], 1, 0.5, parts=False)])
    small, large = (seg_of(pair, replace(QUICK_SCENE, together=size)) for size in (128, 256))
    assert small == pytest.approx(large, rel=0.3)
