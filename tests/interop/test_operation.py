"""Operations: an own kernel declared as one, and all that the declaration gives without a word about it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import pytest
import torch
import warp as wp

from warp_partdr.interop.arrays import warp_array
from warp_partdr.interop.captured_function import call_captured
from warp_partdr.interop.graph_cache import Launch
from warp_partdr.interop.layouts import Tensors
from warp_partdr.interop.operation import Gradients, Operation, OperationWithTwin, split_missing

BATCH = 3


@wp.kernel
def scale(vectors: wp.array[wp.vec3], numbers: wp.array[float], power: float, found: wp.array[wp.vec3]):
    b = wp.tid()
    found[b] = wp.pow(numbers[b], power) * vectors[b]


@dataclass(frozen=True, eq=False)
class Scaled(Operation):
    """Vectors (B, 3) times a power of a number for each body, (B,): the example that ``operation`` shows."""

    power: int
    name = "scale_vectors"

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        vectors, _ = inputs
        return call_captured(prepare, inputs, (vectors.shape,), self.power), ()

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        vectors, numbers = saved
        return call_captured(prepare, (*adjoints, numbers), (vectors.shape,), self.power)


def prepare(inputs: Tensors, outputs: Tensors, power: int) -> Launch:
    """Launch that scales vectors; it is its own adjoint."""
    vectors, numbers, found = warp_array(inputs[0], wp.vec3), warp_array(inputs[1]), warp_array(outputs[0], wp.vec3)
    return partial(wp.launch, scale, len(inputs[0]), [vectors, numbers, power], [found], device=found.device)


def scale_vectors(vectors: torch.Tensor, numbers: torch.Tensor, power: int = 1) -> torch.Tensor:
    return Scaled(power)(vectors, numbers)[0]


class Mixed(OperationWithTwin):
    """Product and sum of two tensors, of which the adjoint also counts how often it is called."""

    calls = 0

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        return self.plain(inputs), (inputs[0] + 100,)

    def adjoint(self, saved: Tensors, adjoints: Gradients) -> Gradients:
        first, second, kept = saved
        assert torch.equal(kept, first + 100)
        Mixed.calls += 1
        (of_product, of_sum), (given, missing) = adjoints, split_missing(adjoints)
        assert missing == (of_product is None, of_sum is None)
        assert given == tuple(each for each in adjoints if each is not None)
        gradients = torch.zeros_like(first), torch.zeros_like(second)
        if of_product is not None:
            gradients = gradients[0] + second * of_product, gradients[1] + first * of_product
        return gradients if of_sum is None else (gradients[0] + of_sum, gradients[1] + of_sum)

    def plain(self, inputs: Tensors) -> Tensors:
        return inputs[0] * inputs[1], inputs[0] + inputs[1]


class Drawn(Operation):
    """Picture without gradient, though its numbers are floating ones, and a copy that has one."""

    name, num_fixed = "draw", 1

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        return (inputs[0].clone(), inputs[0].clone()), ()

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        assert adjoints[0] is None
        return adjoints[1:]


def case(device: str = "cpu") -> tuple[torch.Tensor, torch.Tensor]:
    random = torch.Generator().manual_seed(0)
    vectors, numbers = torch.randn(BATCH, 3, generator=random), torch.rand(BATCH, generator=random) + 0.5
    return vectors.to(device).requires_grad_(), numbers.to(device)


def pair() -> list[torch.Tensor]:
    random = torch.Generator().manual_seed(1)
    return [torch.randn(4, dtype=torch.float64, generator=random).requires_grad_() for _ in range(2)]


@pytest.mark.parametrize("power", [1, 2])
def test_a_kernel_and_its_adjoint_are_an_operation_of_torch(power, device):
    """Three times, so that the last ones are captured."""
    vectors, numbers = case(device)
    pull = torch.randn(BATCH, 3).to(device)
    for _ in range(3):
        found = scale_vectors(vectors, numbers, power)
        (gradient,) = torch.autograd.grad(found, vectors, pull)
        torch.testing.assert_close(found.detach(), vectors.detach() * numbers[:, None] ** power)
        torch.testing.assert_close(gradient, pull * numbers[:, None] ** power)


def test_without_gradients_nothing_is_saved(device):
    with torch.no_grad():
        assert scale_vectors(*case(device)).grad_fn is None
    assert scale_vectors(case(device)[0].detach(), case(device)[1]).grad_fn is None


def test_a_second_derivative_is_an_error_that_names_the_function():
    vectors, numbers = case()
    (first,) = torch.autograd.grad(scale_vectors(vectors, numbers).sum(), vectors, create_graph=True)
    with pytest.raises(NotImplementedError, match=r"^scale_vectors: differentiated twice; expected once"):
        first.sum().backward()


def test_a_second_derivative_by_what_pulls_is_an_error():
    """The gradient of a linear function does not depend on its input, but on the incoming gradient."""
    vectors, numbers = case()
    pull = torch.ones(BATCH, 3, requires_grad=True)
    (first,) = torch.autograd.grad(scale_vectors(vectors, numbers), vectors, pull, create_graph=True)
    with pytest.raises(NotImplementedError, match=r"^scale_vectors: differentiated twice"):
        torch.autograd.grad(first.sum(), pull)


def test_torch_func_is_an_error_that_names_the_function():
    vectors, numbers = case()
    with pytest.raises(NotImplementedError, match=r"^scale_vectors: called under torch\.func"):
        torch.func.grad(lambda moved: scale_vectors(moved, numbers).sum())(vectors.detach())
    with pytest.raises(NotImplementedError, match=r"^scale_vectors: called under torch\.func"):
        torch.func.vmap(lambda moved: scale_vectors(moved, numbers))(torch.stack([vectors.detach()] * 2))


def test_what_was_saved_must_not_change():
    """Also inputs that have no gradient: the gradient would be another call's."""
    vectors, numbers = case()
    found = scale_vectors(vectors, numbers)
    numbers.add_(1)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        found.sum().backward()


@pytest.mark.parametrize("used", [(0,), (1,), (0, 1)])
def test_outputs_that_nobody_uses_have_no_adjoint(used):
    moved = pair()
    first, second = (each.detach() for each in moved)
    found = Mixed()(*moved)
    gradients = torch.autograd.grad([found[index].sum() for index in used], moved)
    torch.testing.assert_close(gradients[0], second * (0 in used) + (1 in used))
    torch.testing.assert_close(gradients[1], first * (0 in used) + (1 in used))


class _Ends(torch.autograd.Function):
    """Identity through which no gradient comes."""

    @staticmethod
    def forward(ctx, numbers):
        return numbers.clone()

    @staticmethod
    def backward(ctx, adjoint):
        return None


@pytest.mark.parametrize("index", [0, 1])
def test_no_gradient_comes_from_outputs_without_adjoints(index):
    moved, before = pair(), Mixed.calls
    gradients = torch.autograd.grad(_Ends.apply(Mixed()(*moved)[index]).sum(), moved, allow_unused=True)
    assert gradients == (None, None)
    assert Mixed.calls == before


def test_inputs_without_gradient_get_none():
    first, second = pair()
    product, _ = Mixed()(first, second.detach())
    (gradient,) = torch.autograd.grad(product.sum(), first)
    torch.testing.assert_close(gradient, second.detach())


def test_pictures_have_no_gradient():
    (moved, _) = pair()
    picture, copy = Drawn()(moved)
    assert not picture.requires_grad
    (gradient,) = torch.autograd.grad(copy.square().sum(), moved)
    torch.testing.assert_close(gradient, 2 * moved.detach())


@pytest.mark.parametrize("used", [(0,), (1,), (0, 1)])
def test_a_twin_gives_derivatives_of_all_orders(used):
    """Also if one input is fixed, or one output is not used."""
    first, second = pair()
    assert torch.autograd.gradcheck(lambda *own: [Mixed()(*own)[index] for index in used], (first, second))
    assert torch.autograd.gradgradcheck(lambda *own: [Mixed()(*own)[index] for index in used], (first, second))
    fixed = second.detach()
    (slope,) = torch.autograd.grad(Mixed()(first, fixed)[0].pow(2).sum(), first, create_graph=True)
    torch.testing.assert_close(torch.autograd.grad(slope.sum(), first)[0], 2 * fixed.square())


def test_a_twin_serves_torch_func():
    first, second = (each.detach() for each in pair())
    before = Mixed.calls
    torch.testing.assert_close(torch.func.grad(lambda own: Mixed()(own, second)[0].sum())(first), second)
    torch.testing.assert_close(torch.func.vmap(lambda *own: Mixed()(*own)[1])(first, second), first + second)
    assert Mixed.calls == before


def test_a_twin_serves_many_gradients_at_once():
    moved = pair()
    before, (product, _) = Mixed.calls, Mixed()(*moved)
    pulls = torch.randn(5, 4, dtype=torch.float64)
    found = torch.func.vmap(lambda pull: torch.autograd.grad(product, moved[0], pull, retain_graph=True)[0])(pulls)
    torch.testing.assert_close(found, pulls * moved[1].detach())
    assert Mixed.calls == before


def test_first_derivatives_are_the_adjoints_own():
    """Not the twin's, which is slower."""
    moved, before = pair(), Mixed.calls
    Mixed()(*moved)[0].sum().backward()
    assert Mixed.calls == before + 1
