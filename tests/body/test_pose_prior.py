"""The prior knows possible from impossible poses, is symmetric, differentiable, and fits the template."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from warp_partdr.body.pose_prior import FREE_PARTS, NUM_FEATURES, PosePrior, mirror_features, up_direction
from warp_partdr.body.template import PART_NAMES, template
from warp_partdr.errors import InputError
from warp_partdr.lab.synthetic import mocap, mocap_files

PATH = resources.files("warp_partdr").joinpath("assets/pose_prior.npz")
UP = torch.tensor([[0.0, 1.0, 0.0]])


@pytest.fixture(scope="module")
def prior() -> PosePrior:
    return PosePrior()


@pytest.fixture(scope="module")
def held_out(shared: Path) -> tuple[torch.Tensor, torch.Tensor]:
    """Rotation vectors and up directions of poses the prior has not learned from."""
    frames = mocap_files.held_out_frames(shared / "data" / "mocap", 400)
    return tuple(
        torch.tensor(values, dtype=torch.float32) for values in (frames.rotation_vectors(), frames.up_directions())
    )


def rest_with(part: str, vector: tuple[float, float, float]) -> torch.Tensor:
    """The rest pose with one joint bent, shape (1, 20, 3)."""
    vectors = torch.zeros(1, 20, 3)
    vectors[0, PART_NAMES.index(part)] = torch.tensor(vector)
    return vectors


def mirrored(vectors: torch.Tensor, up: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    order, sign = mirror_features()
    features = torch.cat([vectors[:, list(FREE_PARTS)].flatten(1), up], 1).numpy()[:, order] * sign
    image = torch.zeros_like(vectors)
    image[:, list(FREE_PARTS)] = torch.tensor(features[:, :-3], dtype=vectors.dtype).view(len(vectors), -1, 3)
    return image, torch.tensor(features[:, -3:], dtype=up.dtype)


@pytest.fixture(scope="module")
def packaged() -> dict[str, np.ndarray]:
    with PATH.open("rb") as file, np.load(file, allow_pickle=False) as data:
        return dict(data)


def test_file_is_small_credited_and_made_for_this_template(packaged: dict[str, np.ndarray]) -> None:
    assert len(PATH.read_bytes()) < 100_000
    assert "mocap.cs.cmu.edu" in str(packaged["credit"])
    cosines = (packaged["rest_directions"] * template().rest_directions).sum(1)
    # Joint rotations are relative to the rest pose: after a change, run scripts/learn_pose_prior.py again.
    assert np.degrees(np.arccos(np.clip(cosines, -1, 1))).max() < 2.0


def test_likelihood_is_that_of_the_mixture_in_the_file(packaged: dict[str, np.ndarray]) -> None:
    weights, means, whitening = (packaged[key].astype(np.float64) for key in ("weights", "means", "whitening"))
    order, sign = mirror_features()
    assert 2 * weights.sum() == pytest.approx(1.0, abs=1e-5)

    def density(features: np.ndarray) -> float:
        total = 0.0
        for x in (features, features[order] * sign):  # a component's twin at x is the component at the mirrored x
            for weight, mean, factor in zip(weights, means, whitening, strict=True):
                covariance = np.linalg.inv(factor) @ np.linalg.inv(factor).T
                offset = x - mean
                exponent = -0.5 * offset @ np.linalg.solve(covariance, offset) - 0.5 * np.linalg.slogdet(covariance)[1]
                total += weight * np.exp(exponent)
        return total

    best = max(density(mean) for mean in means)
    prior = PosePrior().double()
    for features in (means[0], 0.5 * (means[1] + means[2]), np.append(np.full(NUM_FEATURES - 3, 0.1), [0.0, 1.0, 0.0])):
        vectors = torch.zeros(1, 20, 3, dtype=torch.float64)
        vectors[0, list(FREE_PARTS)] = torch.tensor(features[:-3]).view(-1, 3)
        nll = prior(vectors, torch.tensor(features[None, -3:]))
        assert nll.item() == pytest.approx(np.log(best) - np.log(density(features)), abs=2e-3)


def test_gradients_are_the_derivatives() -> None:
    prior = PosePrior().double()
    vectors = (0.4 * torch.randn(3, 20, 3, dtype=torch.float64)).requires_grad_()
    up = torch.randn(3, 3, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(prior, (vectors, up))
    assert torch.autograd.gradcheck(prior.joint_limits, (3 * vectors,))


@pytest.mark.parametrize("angle", [0.0, 1e-12, np.pi - 1e-6, np.pi, 100.0])
def test_values_and_gradients_are_finite(prior: PosePrior, device: str, angle: float) -> None:
    vectors = torch.zeros(2, 20, 3, device=device)
    vectors[..., 1] = angle
    vectors.requires_grad_()
    up = UP.expand(2, 3).to(device).clone().requires_grad_()
    on_device = PosePrior().to(device)
    loss = on_device(vectors, up) + on_device.joint_limits(vectors)
    loss.sum().backward()
    assert torch.isfinite(loss).all()
    assert vectors.grad is not None
    assert torch.isfinite(vectors.grad).all()
    assert torch.isfinite(up.grad).all()


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_other_dtypes_are_converted(prior: PosePrior, dtype: torch.dtype) -> None:
    vectors = 0.25 * torch.ones(1, 20, 3)  # exact in each of them
    assert torch.equal(prior(vectors.to(dtype), UP.to(dtype)), prior(vectors, UP))
    assert torch.equal(prior.joint_limits(vectors.to(dtype)), prior.joint_limits(vectors))


def test_batched_is_the_same_as_one_by_one(prior: PosePrior) -> None:
    assert prior(torch.zeros(0, 20, 3), torch.zeros(0, 3)).shape == (0,)
    assert prior.joint_limits(torch.zeros(0, 20, 3)).shape == (0,)
    vectors, up = 0.3 * torch.randn(5, 20, 3), torch.nn.functional.normalize(torch.randn(5, 3))
    single = torch.cat([prior(vectors[i : i + 1], up[i : i + 1]) for i in range(5)])
    torch.testing.assert_close(prior(vectors, up), single, rtol=1e-5, atol=1e-4)


def test_mirrored_poses_are_equally_likely(prior: PosePrior) -> None:
    vectors, up = 0.4 * torch.randn(50, 20, 3), torch.nn.functional.normalize(torch.randn(50, 3))
    images = mirrored(vectors, up)
    assert not torch.allclose(images[0], vectors)
    torch.testing.assert_close(prior(*images), prior(vectors, up), rtol=1e-4, atol=1e-2)
    # The hips take no part in the mirror image made here.
    vectors[:, :2] = 0.0
    torch.testing.assert_close(prior.joint_limits(images[0]), prior.joint_limits(vectors), rtol=1e-4, atol=0.02)


@pytest.mark.parametrize("side", ["left", "right"])
def test_limits_let_knees_and_elbows_bend_one_way_only(prior: PosePrior, side: str) -> None:
    """A left knee at +x takes the foot behind; a left elbow at -y takes the hand in front."""
    out = 1.0 if side == "left" else -1.0
    for part, vector, axis, way in (
        (f"{side}_lower_leg", (1.2, 0.0, 0.0), (1.0, 0.0, 0.0), -0.2),
        (f"{side}_forearm", (0.0, -1.2 * 0.87 * out, 1.2 * 0.5 * out), (0.0, -out, 0.0), 0.15),
    ):
        assert prior.joint_limits(rest_with(part, vector)).item() == pytest.approx(0.0, abs=1e-3)
        reverse = tuple(-component for component in vector)
        assert prior.joint_limits(rest_with(part, reverse)).item() > 1.0
        rotations = mocap.rotation_matrices(rest_with(part, axis).numpy().astype(np.float64))
        end = mocap.joint_positions(np.eye(3)[None], rotations)[0, PART_NAMES.index(part) + 1]
        assert end[2] / way > 1


def test_held_out_poses_cost_little_and_impossible_ones_much(
    prior: PosePrior, held_out: tuple[torch.Tensor, torch.Tensor]
) -> None:
    vectors, up = held_out
    nll = prior(vectors, up)
    assert nll.median() < 25.0
    assert prior.joint_limits(vectors).median() == 0.0
    assert prior.joint_limits(vectors).mean() < 0.05
    for part in ("left_lower_leg", "right_lower_leg", "left_forearm", "right_forearm"):
        index = PART_NAMES.index(part)
        bent = vectors[:, index].norm(dim=-1) > 0.5
        reversed_ = vectors[bent].clone()
        reversed_[:, index] *= -1
        worse = prior(reversed_, up[bent]) - nll[bent]
        assert worse.median() > 10.0, part
        assert (worse > 0).float().mean() > 0.95, part
        assert prior.joint_limits(reversed_).min() > 0.1, part


def test_leaning_and_twisting_without_reason_cost(
    prior: PosePrior, held_out: tuple[torch.Tensor, torch.Tensor]
) -> None:
    vectors, up = held_out
    upright = up[:, 1] > 0.95
    vectors, up = vectors[upright], up[upright]
    nll = prior(vectors, up)
    for axis in (0, 2):
        for angle in (-40.0, 40.0):
            turn = mocap.rotation_matrices(np.radians(angle) * np.eye(3)[axis])
            leaning = up @ torch.tensor(turn.T, dtype=torch.float32)
            assert (prior(vectors, leaning) - nll).mean() > 5.0
    twisted = vectors.clone()
    twisted[:, PART_NAMES.index("chest"), 1] += np.radians(60)
    assert (prior(twisted, up) - nll).mean() > 20.0


def test_exemplars_are_likely_distinct_poses(prior: PosePrior) -> None:
    assert prior.exemplars.shape == (len(prior.exemplar_ups), 20, 3)
    assert len(prior.exemplars) >= 24
    torch.testing.assert_close(prior.exemplar_ups.norm(dim=-1), torch.ones(len(prior.exemplars)), atol=2e-3, rtol=0)
    nll = prior(prior.exemplars, prior.exemplar_ups)
    assert nll.max() < 40.0
    distances = torch.cdist(prior.exemplars.flatten(1), prior.exemplars.flatten(1))
    assert (distances + 10 * torch.eye(len(distances))).min() > 0.3
    assert prior(prior.mean_pose[None], prior.mean_up[None]).item() < 20.0
    assert prior.joint_limits(prior.mean_pose[None]).item() == 0.0


def test_up_direction_is_opposite_to_gravity_before_a_level_camera() -> None:
    facing = torch.diag(torch.tensor([1.0, -1.0, -1.0]))[None]
    torch.testing.assert_close(up_direction(facing), UP)
    # Leaning toward the camera by 30 degrees: up is behind the pelvis' own y axis.
    lean = torch.tensor(mocap.rotation_matrices(np.array([np.pi / 6, 0.0, 0.0])), dtype=torch.float32)
    torch.testing.assert_close(up_direction(facing @ lean), torch.tensor([[0.0, np.cos(np.pi / 6), -0.5]]).float())


@pytest.mark.parametrize(
    ("vectors", "up", "message"),
    [
        ((2, 19, 3), (2, 3), r"rotation_vectors: shape \(2, 19, 3\); expected \(B, 20, 3\)"),
        ((20, 3), (3,), r"rotation_vectors: shape \(20, 3\)"),
        ((2, 20, 3), (2, 2), r"up: shape \(2, 2\); expected \(B, 3\)"),
        ((2, 20, 3), (1, 3), r"up: batch 1; expected 2"),
    ],
)
def test_wrong_shapes_are_named(prior: PosePrior, vectors: tuple[int, ...], up: tuple[int, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        prior(torch.zeros(vectors), torch.zeros(up))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (None, "not readable"),
        (lambda data: {"means": np.zeros(3)}, "no array whitening, "),
        (lambda data: data | {"means": data["means"][:, :-1]}, "means has shape"),
        (lambda data: data | {"means": data["means"] * np.nan}, "means is not finite"),
    ],
)
def test_files_that_are_no_prior_are_named(
    change: Any, message: str, packaged: dict[str, np.ndarray], tmp_path: Path
) -> None:
    path = tmp_path / "other.npz"
    path.write_text("no archive") if change is None else np.savez(path, **change(packaged))
    with pytest.raises(InputError, match=f"other.npz: {message}"):
        PosePrior(path)
