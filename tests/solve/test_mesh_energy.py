"""The energy of detailed bodies: one table of terms, for people who are alone and for those of a scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from warp_partdr.body.labels import IGNORE, LabelSet, label_set
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.inputs.scene import Scene
from warp_partdr.lab.synthetic.scene_people import LABELS, make_views
from warp_partdr.models.anny import anny
from warp_partdr.solve.mesh.energy import TERMS, mesh_energy
from warp_partdr.solve.mesh.gather import gather_starts
from warp_partdr.solve.mesh.mesh_options import MeshOptions
from warp_partdr.solve.mesh.observed_body import ObservedBody
from warp_partdr.solve.mesh.starts import Starts
from warp_partdr.solve.scene.observations import observe_scene
from warp_partdr.solve.scene.options import SceneOptions
from warp_partdr.solve.scene.plan import plan_scene
from warp_partdr.solve.scene.start import gather_scene

QUICK = SceneOptions(mesh=MeshOptions(iterations=2, size=96, vertices=800, apart=0.2), together=96, apart=0.4)


@pytest.fixture(scope="module")
def observed_bodies() -> list[ObservedBody]:
    """A person of PartBench, seen by one camera."""
    return observe_scene(make_views(3, 1).scene, "cpu")


def beside_each_other(observed_bodies: list[ObservedBody], options: MeshOptions) -> Starts:
    """Starts of the person twice, each in a scene of one person."""
    energy = mesh_energy(anny(), options, LABELS)
    with torch.no_grad():
        return gather_starts(energy, anny(), [observed_bodies[0], observed_bodies[0]])


def test_names_and_weights_of_the_terms(observed_bodies) -> None:
    names = [term.name for term in TERMS]
    assert names == ["proj", "depth", "turns", "shape", "clothes", "apart", "ground", "sliding", "seg"]
    people = beside_each_other(observed_bodies, QUICK.mesh)
    alone = mesh_energy(anny(), QUICK.mesh, LABELS).factors(people)
    scale = (256 / QUICK.mesh.size) ** 2  # labels count as if they were drawn at 256 px
    expected = {"proj": 0.5, "depth": 2.0, "turns": 4.0, "shape": 0.5, "clothes": 1.0, "apart": 0.2, "seg": 0.1 * scale}
    assert alone == pytest.approx(expected | {"ground": 0.0, "sliding": 0.0})


def test_two_of_a_scene_meet_and_two_alone_do_not(observed_bodies) -> None:
    """Both cases have the same two people at the same position."""
    people = beside_each_other(observed_bodies, QUICK.mesh)
    single = replace(QUICK.mesh, apart=0.2)
    with torch.no_grad():
        both = mesh_energy(anny(), single, LABELS)(people, people.at_rest())["apart"]
        scene = Scene(
            make_views(3, 1).scene.views, [replace(observed_bodies[0].source, person=person) for person in range(2)]
        )
        seen = [replace(observed_bodies[0], source=observation) for observation in scene.observations]
        plan = plan_scene(scene, seen, anny(), QUICK)
        together = gather_scene(plan, seen)
        met = plan.energy(together, together.at_rest())["apart"]
    assert plan.energy.factors(together)["apart"] == 0.4
    assert both.shape == met.shape == (2,)
    torch.testing.assert_close(both[0], both[1])
    assert float(met.min()) > float(both.max()) + 100  # [cm^2]


def test_clothes_and_labels_cost_nothing_where_there_are_none(observed_bodies) -> None:
    naked = replace(QUICK.mesh, clothes=None, seg=0.0, apart=0.0)
    people = beside_each_other(observed_bodies, naked)
    energy = mesh_energy(anny(), naked, LABELS)
    assert people.alone is None
    assert energy(people, people.at_rest()).keys() == {"proj", "depth", "turns", "shape"}


def test_starts_are_copied_with_all_that_is_in_them(observed_bodies) -> None:
    people = beside_each_other(observed_bodies, QUICK.mesh)
    names = set(people.named())
    assert {"rotations", "aims.points", "alone.target"} <= names
    assert not any(name.startswith(("views", "together", "feet", "smooth")) for name in names)
    copied = people.copied()
    assert copied.views is None
    for name, tensor in copied.named().items():
        assert torch.equal(tensor, people.named()[name])
        assert tensor.data_ptr() != people.named()[name].data_ptr()


def test_moves_of_bodies_come_before_those_of_people(observed_bodies) -> None:
    """A person in three frames has one shape."""
    scene = make_views(3, 1).scene
    film = Scene(scene.views, [replace(observed_bodies[0].source, frame=frame) for frame in range(3)])
    seen = [replace(observed_bodies[0], source=observation) for observation in film.observations]
    with torch.no_grad():
        people = gather_scene(plan_scene(film, seen, anny(), replace(QUICK, smoothing=0.0)), seen)
    rates = people.learning_rates()
    moved = people.moved(torch.arange(len(rates), dtype=torch.float32))
    joints = people.turn_variances.shape[1]
    assert moved.turns.shape == (3, joints, 3)
    assert moved.turns[1, 0].tolist() == [3 * joints + 3, 3 * joints + 4, 3 * joints + 5]
    assert (moved.shift[0] - people.shift[0]).tolist() == pytest.approx([3 * joints + 1, 3 * joints + 2], abs=1e-3)
    first = 3 * (3 * joints + 3)
    assert moved.shape.shape == (1, anny().num_shapes)
    assert float(moved.shape[0, 0] - people.shape[0, 0]) == pytest.approx(first, abs=1e-3)
    assert rates[:first].unique().tolist() == [1.0]
    assert rates[first:].unique().tolist() == pytest.approx([0.3, 5.0])


def test_a_mask_of_one_picture_counts_less_and_keypoints_more() -> None:
    mask = label_set("full1")
    shown = make_views(3, 1).scene
    scene = Scene(shown.views, [replace(each, parts=as_mask(each.parts, mask)) for each in shown.observations])
    seen = observe_scene(scene, "cpu")
    energy = mesh_energy(anny(), QUICK.mesh, mask)
    with torch.no_grad():
        alone = energy.factors(gather_starts(energy, anny(), seen))
        film = Scene(scene.views, [replace(seen[0].source, frame=frame) for frame in range(2)])
        frames = [replace(seen[0], source=observation) for observation in film.observations]
        plan = plan_scene(film, frames, anny(), QUICK)
        moving = plan.energy.factors(gather_scene(plan, frames))
    drawn = QUICK.mesh.drawn_seg
    assert (alone["proj"], alone["seg"]) == pytest.approx((2 * QUICK.mesh.proj, 0.3 * drawn))
    assert (moving["proj"], moving["seg"]) == pytest.approx((QUICK.mesh.proj, drawn))


def as_mask(parts: PartLabels | None, mask: LabelSet) -> PartLabels:
    """Mask of the person whom part labels show."""
    assert parts is not None
    groups = np.where((parts.groups > 0) & (parts.groups != IGNORE), 1, parts.groups).astype(np.uint8)
    return PartLabels(mask, groups)
