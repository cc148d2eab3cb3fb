"""Scenes: one body is as in the mesh stage, several cameras know the depth, and labels know who stands in front."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.quick import QUICK_SCENE

from warp_partdr import Perspective, metrics
from warp_partdr.body.skeletons import MPJPE_HIPS, MPJPE_JOINTS
from warp_partdr.errors import InputError
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.scene import PersonShape, Scene, SceneObservation, View
from warp_partdr.lab.synthetic.scene_people import LABELS, make_pair, make_views
from warp_partdr.models.anny import anny
from warp_partdr.models.capsules import measure_capsules
from warp_partdr.render.part_mesh import PartMesh
from warp_partdr.solve.mesh.energy import mesh_energy
from warp_partdr.solve.mesh.feet import FEET
from warp_partdr.solve.mesh.observed_body import ObservedBody
from warp_partdr.solve.mesh.starts import LabelPictures, StandingFeet, Starts
from warp_partdr.solve.scene.depth_order import exchange, grown, order_people
from warp_partdr.solve.scene.fitting import fit_scene
from warp_partdr.solve.scene.observations import observe_scene
from warp_partdr.solve.scene.options import SceneOptions
from warp_partdr.solve.scene.plan import ScenePlan, plan_scene
from warp_partdr.solve.scene.smoothing import time_shares
from warp_partdr.solve.scene.start import gather_scene


def prepared(
    scene: Scene,
    device: str,
    options: SceneOptions = QUICK_SCENE,
    observed_bodies: Sequence[ObservedBody] | None = None,
) -> tuple[ScenePlan, Starts]:
    observed_bodies = observed_bodies or observe_scene(scene, device)
    plan = plan_scene(scene, observed_bodies, anny(torch.device(device)), options)
    with torch.no_grad():
        return plan, gather_scene(plan, observed_bodies)


def pelvises(plan: ScenePlan, people: Starts) -> torch.Tensor:
    """Pelvises where the fit starts, in the world."""
    found = plan.energy.place(people, people.at_rest()).pelvises
    assert found is not None
    return found


def test_one_body_in_one_picture_has_the_mesh_stage_s_energy(device):
    scene = make_views(3, 1).scene
    turned = replace(scene, views=[View(scene.views[0].camera)])
    plan, people = prepared(turned, device, replace(QUICK_SCENE, mesh=replace(QUICK_SCENE.mesh, apart=1.0)))
    assert people.alone is not None
    alone = replace(people, views=None, alone=LabelPictures(people.alone.target, people.alone.borders))
    moves = 0.02 * torch.randn(people.learning_rates().shape, generator=torch.Generator().manual_seed(0)).to(device)
    unknowns = people.moved(moves)
    energy, stage = plan.energy, mesh_energy(plan.model, plan.options.mesh, LABELS)
    costs, expected = energy(people, unknowns), stage(alone, unknowns)
    assert costs.keys() == expected.keys()
    for name, cost in costs.items():
        own, other = energy.factors(people)[name], stage.factors(alone)[name]
        torch.testing.assert_close(own * cost.sum(), other * expected[name].sum(), rtol=2e-3, atol=1e-4)


def test_several_pictures_of_a_body_count_twice_or_plainly(monkeypatch):
    def refuse(*_: object) -> torch.Tensor:
        raise AssertionError

    for name in ("keypoint_costs", "label_costs"):
        monkeypatch.setattr(f"warp_partdr.solve.mesh.energy.{name}", refuse)
    for views, times in ((1, 1), (2, 2)):
        plan, people = prepared(make_views(3, views).scene, "cpu", QUICK_SCENE)
        energy, factors = plan.energy, plan.energy.factors(people)
        assert (factors["proj"], factors["seg"]) == (times * QUICK_SCENE.mesh.proj, times * QUICK_SCENE.mesh.drawn_seg)
        if views > 1:
            energy(people, people.at_rest())
        else:
            with pytest.raises(AssertionError):
                energy(people, people.at_rest())


def test_two_cameras_find_where_somebody_stands(device):
    sample = make_views(11, 2)
    found = fit_scene(sample.scene, options=QUICK_SCENE, device=device).landmarks(MPJPE_JOINTS)[0, 0].cpu().numpy()
    off = 1000 * np.linalg.norm(found - sample.joints[0, 0], axis=-1).mean()
    assert off < 40  # [mm]
    one = replace(
        sample.scene, observations=[observation for observation in sample.scene.observations if observation.view == 0]
    )
    alone = fit_scene(one, options=QUICK_SCENE, device=device).landmarks(MPJPE_JOINTS)[0, 0].cpu().numpy()
    assert 1000 * np.linalg.norm(alone - sample.joints[0, 0], axis=-1).mean() > 1.3 * off


def test_the_world_s_frame_does_not_matter():
    scene = make_views(5, 2).scene
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1)))[0]
    turn = turn * torch.linalg.det(turn)
    move = torch.tensor([2.0, -1.0, 3.0])  # of the world's origin
    elsewhere = [
        replace(v, rotation=v.rotation @ turn, translation=v.translation + v.rotation @ move) for v in scene.views
    ]
    here, there = (fit_scene(each, options=QUICK_SCENE).joints for each in (scene, replace(scene, views=elsewhere)))
    apart = ((there @ turn.mT + move) - here).norm(dim=-1)
    assert apart.mean() < 2e-3  # [m]
    assert apart.max() < 1e-2  # a fingertip or toe, whose turn rests on little, amplifies how sums are rounded


def test_a_pair_in_the_wrong_order_is_exchanged(device):
    sample = make_pair(100, "clean")
    plan, _ = prepared(sample.scene, device)
    depths = sample.scene.views[0].to_camera(torch.from_numpy(sample.joints[:, 0].mean(1)))[:, 2]
    front = int(depths.argmin())
    with torch.no_grad():
        right = observe_scene(sample.scene, device)
        away = [float(observed.observation.lens[0] / observed.body.log_scale.exp()) for observed in right]
        factor = math.sqrt(1.08 * max(1.0, away[1 - front] / away[front]))
        wrong = [grown(observed, factor if observed.person == front else 1 / factor) for observed in right]
        people, observed_bodies = order_people(plan, wrong)
        there = pelvises(plan, people).cpu()
        assert int(sample.scene.views[0].to_camera(there)[:, 2].argmin()) == front
        assert exchange(plan, people, people.at_rest(), observed_bodies) is None
        # Known sizes, or a second camera, tell how far people are: then nobody is exchanged.
        mistaken = gather_scene(plan, wrong)
        assert exchange(plan, mistaken, mistaken.at_rest(), wrong) is not None
        for known in (
            replace(mistaken, unknown=0 * mistaken.unknown),
            replace(mistaken, views=replace(mistaken.views, rotations=mistaken.views.rotations.expand(2, 3, 3))),
        ):
            assert exchange(plan, known, mistaken.at_rest(), wrong) is None


def test_known_shapes_stay_as_they_are():
    scene = make_pair(102, "clean").scene
    shape = 0.5 * torch.ones(anny().num_shapes)
    known = replace(scene, shapes={1: PersonShape(shape, 0.01 * torch.ones(8))})
    _, people = prepared(known, "cpu")
    moved = people.moved(torch.ones_like(people.learning_rates()))
    assert torch.equal(moved.shape[1], shape)
    assert torch.equal(moved.clothes[1], 0.01 * torch.ones(8))
    torch.testing.assert_close(moved.shape[0] - people.shape[0], torch.ones_like(shape))


def test_each_view_is_seen_by_its_own_camera():
    scene = make_views(3, 2).scene
    usual = observe_scene(scene, "cpu")
    first, second = scene.views
    narrow = replace(second, camera=replace(second.camera, focal=2 * second.camera.focal))
    found = observe_scene(replace(scene, views=[first, narrow]), "cpu")
    for observed, before in zip(found, usual, strict=True):
        factor = 2.0 if observed.view else 1.0
        assert float(observed.observation.lens[0]) == pytest.approx(
            factor * float(before.observation.lens[0]), rel=1e-5
        )


def test_labels_along_no_bone_are_left_out_and_that_is_told():
    scene = make_views(3, 1).scene
    observation = scene.observations[0]
    assert observation.parts is not None
    corner = np.zeros_like(observation.parts.groups)
    corner[:3, :3] = 1
    (observed,) = observe_scene(
        replace(scene, observations=[replace(observation, parts=replace(observation.parts, groups=corner))]), "cpu"
    )
    assert observed.observation.labels is None
    (warning,) = observed.evidence.warnings
    assert warning.endswith("only the keypoints are used")


def test_pixels_that_several_claim_or_somebody_does_not_know_are_ignored():
    """One person comes twice; then a second one of whom a corner of the background is not known."""
    scene = make_views(3, 1).scene
    observation = scene.observations[0]
    assert observation.parts is not None
    _, people = prepared(replace(scene, observations=[observation, replace(observation, person=1)]), "cpu")
    assert people.overlapping is not None
    both = people.overlapping.target
    assert set(both.unique().tolist()) == {0, 255}
    low = observation.keypoints.points[observation.keypoints.visible].min(0).astype(int)
    unknown = observation.parts.groups.copy()
    corner = unknown[low[1] - 8 : low[1], low[0] - 8 : low[0]]
    assert not corner.any()
    corner[:] = 255
    other = replace(observation, parts=replace(observation.parts, groups=unknown), person=1)
    _, people = prepared(replace(scene, observations=[observation, other]), "cpu")
    assert people.overlapping is not None
    changed = people.overlapping.target[both != people.overlapping.target]
    assert changed.numel() > 0
    assert bool((changed == 255).all())


def test_starts_of_several_views_are_where_rays_meet_whatever_the_world_s_frame():
    sample = make_views(11, 2)
    plan, people = prepared(sample.scene, "cpu")
    pelvis = pelvises(plan, people)[0].numpy()
    assert np.linalg.norm(pelvis - sample.joints[0, 0, MPJPE_HIPS].mean(0)) < 0.1
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(2)))[0]
    turn = turn * torch.linalg.det(turn)
    move = torch.tensor([2.0, -1.0, 3.0])  # of the world's origin
    views = [
        replace(view, rotation=view.rotation @ turn, translation=view.translation + view.rotation @ move)
        for view in sample.scene.views
    ]
    _, turned = prepared(replace(sample.scene, views=views), "cpu")
    there = pelvises(plan, turned)[0]
    np.testing.assert_allclose((turn @ there + move).numpy(), pelvis, atol=1e-3)
    assert float(people.translation.norm()) > 1e-3
    torch.testing.assert_close(turned.translation @ turn.mT, people.translation, atol=1e-4, rtol=0)


def test_only_who_stands_is_held_to_the_ground():
    plan, people = prepared(make_pair(102, "clean").scene, "cpu")
    rest = people.at_rest()
    plane = torch.tensor([0.0, -1.0, 0.0, -2.0])
    held = replace(people, feet=StandingFeet(plane, torch.tensor([0.0, 0.5])))
    energy, names = plan.energy, plan.energy.drawn.model.landmark_names
    with torch.no_grad():
        cost, points = energy(held, rest)["ground"], energy.place(people, rest).points
    heights = 2 - points[:, [names.index(name) for name in FEET], 1].amax(1)  # y is down
    torch.testing.assert_close(cost, torch.tensor([0.0, 0.5]) * (100 * heights).square(), rtol=1e-3, atol=0)
    assert float(cost[1]) > 1


def test_people_are_drawn_together():
    sample = make_pair(102, "clean")
    _, people = prepared(sample.scene, "cpu")
    assert people.overlapping is not None
    assert people.alone is None
    shown = set(people.overlapping.target.unique().tolist()) - {0, 255}
    assert min(shown) <= LABELS.num_groups < max(shown) <= 2 * LABELS.num_groups
    fit = fit_scene(sample.scene, options=QUICK_SCENE)
    for person in range(2):
        error = metrics.pa_mpjpe(fit.landmarks(MPJPE_JOINTS)[person, 0].numpy(), sample.joints[person, 0])
        assert 1000 * float(error) < 90


def test_frames_in_which_nobody_is_seen_are_bridged():
    observation = make_views(7, 1).scene.observations[0]
    views = make_views(7, 1).scene.views
    scene = Scene(views, [observation, replace(observation, frame=4)])
    fit = fit_scene(scene, options=QUICK_SCENE)
    assert fit.joints.shape == (1, 5, 21, 3)
    assert fit.joints.isfinite().all()
    assert (fit.joints[0, 2] - fit.joints[0, 0]).norm(dim=-1).max() < 0.05


def test_a_person_s_frames_are_placed_in_one_camera():
    """Moves that are smooth in one camera's picture are not if frames change between two."""
    sample = make_views(11, 2)

    def seen(view: int, frame: int, share: float) -> SceneObservation:
        observation = sample.scene.observations[view]
        keypoints = replace(observation.keypoints, confidence=np.float32(share) * observation.keypoints.confidence)
        return replace(observation, keypoints=keypoints, frame=frame)

    sure = [(1.0, 0.2), (0.6, 0.7), (1.0, 0.2), (0.6, 0.7)]
    observations = [seen(view, frame, share) for frame, both in enumerate(sure) for view, share in enumerate(both)]
    _, people = prepared(replace(sample.scene, observations=[*observations, seen(1, 4, 0.9)]), "cpu")
    first, second = (view.rotation for view in sample.scene.views)
    for rotation, expected in zip(people.views.crop_rotations, [first] * 4 + [second], strict=True):
        assert torch.equal(rotation, expected)


def test_shares_of_frames_fall_with_their_distance_in_time():
    seen = torch.tensor([[True, True, True, False, False, False]])
    shares = time_shares(seen, torch.arange(6.0, dtype=torch.float64), 1.0)[0]
    torch.testing.assert_close(shares.sum(1), torch.ones(6, dtype=torch.float64))
    assert (shares[:, 3:] == 0).all()
    assert shares[1, 0] == shares[1, 2] < shares[1, 1]
    assert shares[5].argmax() == 2


def test_smoothing_goes_by_seconds():
    observation, views = make_pair(101, "clean").scene.observations[0], make_pair(101, "clean").scene.views
    film = Scene(views, [replace(observation, frame=frame) for frame in range(5)])
    even = prepared(film, "cpu")[1].smooth
    torch.testing.assert_close(prepared(replace(film, times=3 + np.arange(5) / 30), "cpu")[1].smooth, even)
    assert float(even[2, 3]) > 0.1
    lost = prepared(replace(film, times=[0.0, 1 / 30, 2 / 30, 3.0, 3.0 + 1 / 30]), "cpu")[1].smooth
    assert float(lost[:3, 3:].abs().max()) < 1e-6  # what lies 3 s apart is not one motion
    torch.testing.assert_close(
        lost[:3, :3], prepared(replace(film, observations=film.observations[:3]), "cpu")[1].smooth
    )


def test_steady_motion_is_not_held_back_at_the_ends():
    frames = torch.arange(40, dtype=torch.float64)
    smooth = time_shares(torch.ones(1, 40, dtype=torch.bool), frames, 5.0)[0] @ frames
    assert (smooth - frames).abs().max() < 1.0  # the mean of neighbours is 4 frames off
    assert (smooth - frames)[15:25].abs().max() < 2e-3


def test_starts_keep_more_of_a_fast_move_than_moves_could_bring_back():
    """The person stands still, and in one frame seems nearer."""
    scene, frames, options = make_views(3, 1).scene, 15, replace(QUICK_SCENE, smoothing=0.1)
    observed = observe_scene(scene, "cpu")[0]
    film = Scene(scene.views, [replace(observed.source, frame=frame) for frame in range(frames)])
    observed_bodies = [replace(observed, source=observation) for observation in film.observations]
    body = observed.body
    observed_bodies[7] = replace(
        observed, source=film.observations[7], body=replace(body, log_scale=body.log_scale + 0.01)
    )
    _, people = prepared(film, "cpu", options, observed_bodies)
    kept = float(people.log_scale[7] - body.log_scale) / 0.01
    assert 1.3 * float(people.smooth[7, 7]) < kept < 0.5


def test_a_repeated_mesh_keeps_its_edges_and_counts_its_labels_on():
    one = PartMesh.from_faces(np.array([[0, 1, 2], [2, 1, 3]]), np.array([1, 2]))
    two = one.repeated(2, 5, 6)
    assert two.faces.tolist() == [[0, 1, 2], [2, 1, 3], [6, 7, 8], [8, 7, 9]]
    assert two.face_labels.tolist() == [1, 2, 6, 7]
    assert sorted(two.edges.tolist()) == sorted(
        PartMesh.from_faces(two.faces.numpy(), two.face_labels.numpy()).edges.tolist()
    )
    with pytest.raises(ValueError, match="labels: 1 a mesh"):
        one.repeated(2, 1, 6)
    with pytest.raises(ValueError, match="labels: 200 a mesh, 2 of them; expected 2 to 127"):
        one.repeated(2, 200, 6)


def test_impossible_scenes_and_options_are_refused():
    scene = make_views(3, 1).scene
    observation, views = scene.observations[0], scene.views
    points = observation.keypoints.points.copy()
    joint = int(np.flatnonzero(observation.keypoints.confident)[-1])
    points[joint, 0] -= 1e5
    far, name = replace(observation.keypoints, points=points), observation.keypoints.format.landmarks[joint]
    for observations, message in (
        ([], "observations: none"),
        ([observation, observation], r"observations\[1\]: a second one of person, frame, view \(0, 0, 0\)"),
        ([replace(observation, view=1)], r"observations\[0\].view: 1; expected 0 to 0"),
        ([replace(observation, person=1)], "observations: none of person 0"),
        (
            [replace(observation, keypoints=far)],
            rf"observations\[0\]\.keypoints: {name} at \(.*; expected it in the picture's",
        ),
        (
            [replace(observation, keypoints=far, parts=None)],
            rf"observations\[0\]\.keypoints: {name} at \(.* the camera's picture",
        ),
    ):
        with pytest.raises(InputError, match=message):
            Scene(views, observations)
    with pytest.raises(InputError, match="frame_rate: 0"):
        Scene(views, scene.observations, 0)
    with pytest.raises(TypeError, match=r"observations\[0\]"):
        Scene(views, ["photo.jpg"])
    camera = Perspective.of_picture((100, 100), focal=100)
    with pytest.raises(ValueError, match="rotation: not orthonormal"):
        View(camera, torch.diag(torch.tensor([1.0, 1.0, -1.0])))
    with pytest.raises(ValueError, match="smoothing: -1"):
        SceneOptions(smoothing=-1)
    with pytest.raises(ValueError, match="apart: -1"):
        SceneOptions(apart=-1)
    with pytest.raises(ValueError, match="overlap: 12; expected an integer from 0 to 11"):
        SceneOptions(window=12, overlap=12)
    many = Scene(views, [SceneObservation(observation.keypoints, observation.parts, person) for person in range(19)])
    with pytest.raises(
        InputError, match="19 people with 14 groups each overlap; expected 254 labels at most, which are 18"
    ):
        fit_scene(many, options=QUICK_SCENE)


def walkers() -> Scene:
    """Somebody before one camera, and the same person's keypoints, who walk through each other in three frames."""
    scene = make_views(3, 1).scene
    alone = replace(scene.observations[0], parts=None)
    height = float(np.ptp(alone.keypoints.points[alone.keypoints.visible, 1]))

    def beside(share: float) -> Keypoints2D:
        return replace(alone.keypoints, points=alone.keypoints.points + np.float32([share * height, 0.0]))

    observations = [
        replace(alone, keypoints=beside(sign * share), person=person, frame=frame)
        for person, sign in enumerate((-1, 1))
        for frame, share in enumerate((-0.12, -0.04, 0.08))
    ]
    return replace(scene, observations=observations)


def test_cameras_in_centimetres_are_told() -> None:
    scene = make_views(3, 2).scene
    quick = replace(QUICK_SCENE, mesh=replace(QUICK_SCENE.mesh, iterations=2))
    assert not fit_scene(scene, options=quick).warnings
    far = [replace(view, translation=100 * view.translation) for view in scene.views]
    (told,) = fit_scene(replace(scene, views=far), options=quick).warnings
    assert told.startswith("person0 is ")
    assert "are translations in metres" in told


def test_people_who_walk_through_each_other_end_apart(device):
    """They step aside in depth, so that keypoints are where they were."""
    scene, depths, pulls = walkers(), [], []
    for apart in (0.0, 0.1):
        options = replace(QUICK_SCENE, smoothing=0.03, mesh=replace(QUICK_SCENE.mesh, iterations=60), apart=apart)
        fit = fit_scene(scene, options=options, device=device)
        assert ("apart" in fit.energy) == (apart > 0)
        capsules = measure_capsules(fit.bodies.model)
        placed = capsules.of(fit.bodies.detailed, fit.bodies.shape)
        cost = capsules.overlap(placed, people=2)
        assert cost.shape == (6,)
        depths.append(float(cost.sum()))
        pulls.append(fit.energy["proj"])
    assert depths[0] > 500  # [cm^2]
    assert depths[1] < 0.25 * depths[0]
    assert pulls[1] < 1.5 * pulls[0]


def test_people_of_other_frames_do_not_meet():
    """Two who stand in each other, but at different times, cost nothing."""
    scene = walkers()
    plan, people = prepared(scene, "cpu", replace(QUICK_SCENE, apart=1.0))
    energy = plan.energy
    start = people.at_rest()
    met = float(energy(people, start)["apart"].sum())
    scattered = people.shift.new_zeros(len(people.shift), 3)
    scattered[3:, 2] = 3.0  # the second one; all frames of each stand at one place
    posed = energy.drawn.pose(people, start)
    capsules = energy.capsules
    assert capsules is not None
    shape = start.shape.repeat_interleave(3, 0)
    own = float(capsules.overlap(capsules.of(posed, shape, by=scattered), people=2).sum())
    assert met > 100 + own
    assert own == pytest.approx(float(capsules.overlap(capsules.of(posed, shape)).sum()), abs=1e-3)
