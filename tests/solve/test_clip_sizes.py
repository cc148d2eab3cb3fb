"""Sizes of people in clips: one for all frames, stretched as far as many observations allow."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from warp_partdr.inputs.scene import PersonShape, Scene
from warp_partdr.lab.synthetic.scene_people import make_views
from warp_partdr.models.anny import anny
from warp_partdr.models.measuring import statures
from warp_partdr.solve.mesh.observed_body import ObservedBody
from warp_partdr.solve.scene.clip_sizes import stretch, with_one_size
from warp_partdr.solve.scene.depth_order import grown
from warp_partdr.solve.scene.fitting import fit_scene
from warp_partdr.solve.scene.observations import observe_scene
from warp_partdr.solve.scene.options import SceneOptions

FRAMES = 31  # eight observations


@pytest.fixture(scope="module")
def clip() -> tuple[Scene, list[ObservedBody]]:
    """Somebody small, whom frames see larger and smaller."""
    one = make_views(3, 1).scene
    (seen,) = observe_scene(one, "cpu")
    observations = [replace(one.observations[0], frame=frame) for frame in range(FRAMES)]
    small = grown(seen, 0.7)
    factors = [1.1 if frame % 2 else 1 / 1.1 for frame in range(FRAMES)]
    observed_bodies = [
        replace(grown(small, each), source=observation) for each, observation in zip(factors, observations, strict=True)
    ]
    return Scene(one.views, observations), observed_bodies


def sizes(observed_bodies: list[ObservedBody]) -> torch.Tensor:
    return torch.stack([observed.body.lengths.sum() for observed in observed_bodies])


def test_more_observations_are_stretched_more():
    assert stretch(1) == 1.0
    factors = [stretch(count) for count in (2, 4, 8, 16, 1000)]
    assert factors == sorted(factors)
    assert factors[2] == pytest.approx(1.233, abs=0.01)
    assert factors[-1] < 1.30


def test_frames_get_one_size_and_stay_where_they_are_seen(clip):
    scene, observed_bodies = clip
    found = with_one_size(anny(), scene, observed_bodies)
    own, mean = sizes(found), sizes(observed_bodies).log().mean().exp()
    torch.testing.assert_close(own, own[:1].expand(FRAMES))
    # Smaller than the mean of all frames, as the mean is smaller than the mean person.
    torch.testing.assert_close(own[0], mean * (mean / 2.60) ** (stretch(8) - 1), rtol=1e-4, atol=0)
    for one, other in zip(found, observed_bodies, strict=True):
        torch.testing.assert_close(
            one.body.lengths * one.body.log_scale.exp(), other.body.lengths * other.body.log_scale.exp()
        )
        assert torch.equal(one.body.shift, other.body.shift)


def test_who_is_known_has_the_known_size(clip):
    scene, observed_bodies = clip
    model, shape = anny(), 0.5 * torch.ones(anny().num_shapes)
    known = replace(scene, shapes={0: PersonShape(shape, torch.zeros(8))})
    small, tall = (
        with_one_size(model, known, some)
        for some in (observed_bodies, [grown(observed, 1.5) for observed in observed_bodies])
    )
    torch.testing.assert_close(sizes(small), sizes(tall), rtol=0.02, atol=0)
    # The mean person's lengths are 2.7 m about, of 1.7 m.
    expected = 2.7 / 1.7 * float(statures(model, shape[None]))
    assert float(sizes(small)[0]) == pytest.approx(expected, rel=0.07)


def test_one_frame_and_several_cameras_are_left_alone():
    one, several = make_views(3, 1).scene, make_views(3, 2).scene
    film = replace(
        several,
        observations=[replace(observation, frame=frame) for observation in several.observations for frame in range(2)],
    )
    for scene in (replace(one, observations=one.observations[:1]), several, film):
        observed_bodies = observe_scene(scene, "cpu")
        found = with_one_size(anny(), scene, observed_bodies)
        assert all(one is other for one, other in zip(found, observed_bodies, strict=True))


def test_a_fit_has_the_size_unless_it_is_not_to(clip):
    scene, observed_bodies = clip
    few = replace(scene, observations=scene.observations[:9])
    options = SceneOptions.film()
    options = replace(options, mesh=replace(options.mesh, iterations=1, size=64, vertices=800))
    heights = [
        float(fit_scene(few, options=replace(options, one_size=one), observed_bodies=observed_bodies[:9]).statures)
        for one in (True, False)
    ]
    assert heights[0] < 0.98 * heights[1]
