"""Rotation conversions against SciPy, and at the places where formulas divide by zero."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from warp_partdr.body.rotations import (
    rotation_between,
    rotation_from_6d,
    rotation_from_axis_angle,
    rotation_to_6d,
    rotation_to_axis_angle,
    rotation_to_quaternion,
)

vectors = st.lists(st.floats(-20, 20, allow_subnormal=False), min_size=3, max_size=3)


def is_rotation(matrix: torch.Tensor, tolerance: float = 1e-5) -> bool:
    identity = torch.eye(3, dtype=matrix.dtype)
    return (
        bool(torch.isfinite(matrix).all())
        and torch.allclose(matrix.mT @ matrix, identity, atol=tolerance)
        and torch.allclose(torch.linalg.det(matrix), torch.ones((), dtype=matrix.dtype), atol=tolerance)
    )


@given(vectors)
def test_axis_angle_agrees_with_scipy(vector):
    have = rotation_from_axis_angle(torch.tensor(vector, dtype=torch.float64))
    np.testing.assert_allclose(have.numpy(), Rotation.from_rotvec(vector).as_matrix(), atol=1e-9)


@given(vectors)
def test_axis_angle_comes_back_as_the_same_rotation(vector):
    rotation = rotation_from_axis_angle(torch.tensor(vector, dtype=torch.float64))
    back = rotation_from_axis_angle(rotation_to_axis_angle(rotation))
    torch.testing.assert_close(back, rotation, atol=1e-7, rtol=0)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-5, 1e-4, np.pi - 1e-5, np.pi, 2 * np.pi])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_axis_angle_is_exact_and_differentiable_at_extreme_angles(angle, dtype):
    vector = torch.tensor([0.6, 0.0, 0.8], dtype=dtype).mul(angle).requires_grad_()
    rotation = rotation_from_axis_angle(vector)
    assert is_rotation(rotation)
    back = rotation_to_axis_angle(rotation)
    torch.testing.assert_close(rotation_from_axis_angle(back), rotation, atol=2e-5, rtol=0)
    (back.sum() + rotation.sum()).backward()
    assert torch.isfinite(vector.grad).all()


def test_axis_angle_gradients_agree_with_finite_differences():
    for scale in (0.0, 1e-6, 1.0, 3.1):
        vector = torch.tensor([[0.3, -0.5, 0.8]], dtype=torch.float64).mul(scale).requires_grad_()
        assert torch.autograd.gradcheck(rotation_from_axis_angle, vector)


@given(st.lists(st.floats(-100, 100, allow_subnormal=False), min_size=6, max_size=6))
def test_6d_is_always_a_rotation(columns):
    columns = torch.tensor(columns, dtype=torch.float32, requires_grad=True)
    rotation = rotation_from_6d(columns)
    assert is_rotation(rotation.detach())
    rotation.sum().backward()


@pytest.mark.parametrize(
    "columns",
    [
        [0, 0, 0, 0, 0, 0],
        [1, 0, 0, 2, 0, 0],
        [1, 2, 3, -1, -2, -3],
        [1, 2, 3, 0, 0, 0],
        [0, 0, 0, 0, 1, 0],
        [1e-30, 0, 0, 0, 1e-30, 0],
        [1e30, 0, 0, 0, 1e30, 1e30],
    ],
)
def test_6d_without_direction_is_a_rotation(columns):
    columns = torch.tensor(columns, dtype=torch.float32, requires_grad=True)
    rotation = rotation_from_6d(columns)
    assert is_rotation(rotation.detach())
    rotation.sum().backward()
    assert torch.isfinite(columns.grad).all()


def test_6d_works_on_tensors_without_numbers():
    """While torch compiles, a tensor has a shape and no numbers."""
    assert rotation_from_6d(torch.empty(6, device="meta")).shape == (3, 3)


def test_6d_comes_back_as_the_same_rotation():
    rotation = torch.from_numpy(Rotation.random(20, rng=0).as_matrix())
    torch.testing.assert_close(rotation_from_6d(rotation_to_6d(rotation)), rotation)


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-4, 1e-5])
def test_6d_of_nearly_collinear_columns_is_still_a_rotation(gap):
    """The second axis lies where the columns' small difference points, and is square to the first all the same."""
    axes = torch.from_numpy(Rotation.random(20, rng=0).as_matrix()).float()
    first, aside = axes[..., 0], axes[..., 1]
    rotation = rotation_from_6d(torch.cat([first, first + gap * aside], dim=-1))
    assert is_rotation(rotation, 1e-6)
    assert (rotation - axes).abs().max() < 1e-6 / gap


@pytest.mark.parametrize("angle", [1e-9, 1e-6, 4e-5, 1e-3, 1.0, 3.0, np.pi - 1e-6, np.pi + 1e-6, 4.0, 6.0])
def test_axis_angle_is_the_shortest_way(angle):
    axes = torch.cat([torch.eye(3), torch.nn.functional.normalize(torch.randn(20, 3), dim=-1)]).double()
    turned = rotation_to_axis_angle(rotation_from_axis_angle(angle * axes))
    shortest = angle if angle <= np.pi else angle - 2 * np.pi
    torch.testing.assert_close(turned, shortest * axes, rtol=1e-6, atol=1e-6 * abs(shortest))


def test_turns_take_one_direction_to_another_even_the_opposite(device):
    source = torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.8, 0.0], [0.0, 1.0, 0.0]], device=device)
    target = torch.tensor([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, -0.6, 0.8], [0.0, -1.0, 0.0]], device=device)
    turns = rotation_between(source, target)
    assert turns.isfinite().all()
    torch.testing.assert_close((turns @ source[..., None])[:3, :, 0], target[:3], atol=1e-6, rtol=0)


@given(vectors)
def test_quaternions_agree_with_scipy(vector):
    turn = Rotation.from_rotvec(vector)
    found = rotation_to_quaternion(torch.from_numpy(turn.as_matrix())).numpy()
    expected = turn.as_quat(canonical=True)[[3, 0, 1, 2]]
    assert abs(found @ expected) == pytest.approx(1, abs=1e-9)  # at half a turn both signs are
    assert found[0] >= 0


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_small_angles_of_half_precision_are_rotations(dtype):
    angles = torch.tensor([0.0, 1e-7, 1e-4, 1e-3, 0.01, 0.3, 3.0], dtype=dtype)[:, None] * torch.eye(3, dtype=dtype)[1]
    turns = rotation_from_axis_angle(angles)
    assert turns.dtype == dtype
    torch.testing.assert_close(turns.double(), rotation_from_axis_angle(angles.double()), atol=5e-3, rtol=0)
