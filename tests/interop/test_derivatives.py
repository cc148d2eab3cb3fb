"""Second derivatives: the body's are true, those of what is drawn are an error, and torch.func finds either."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from helpers.bodies import ellipbodies, random_parameters
from helpers.pictures import ball, loss_on_screen, triangle
from helpers.renderers import Scene

from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.posing import pose
from warp_partdr.body.rotations import rotation_from_6d, rotation_from_axis_angle, rotation_to_axis_angle
from warp_partdr.cameras import Perspective, WeakPerspective
from warp_partdr.metrics import mpjpe, pa_mpjpe
from warp_partdr.models.anny import anny
from warp_partdr.models.pose import pose_from_ellipbody
from warp_partdr.models.surfaces import registration_costs, vertex_parts
from warp_partdr.render.ellipsoids import ellipsoid_label_loss

NAMES = ("global_orient", "translation", "rotations", "lengths", "thicknesses")


def everything(*parameters):
    """Each tensor of posed bodies."""
    posed = pose(*parameters)
    return posed.joints, posed.rotations, posed.centres, posed.axes, posed.semi_axes, posed.vertices(0)


def cubes(*parameters):
    """A number that hangs on each tensor of posed bodies, with derivatives of all orders."""
    return torch.stack([tensor.pow(3).sum() for tensor in everything(*parameters)]).sum()


def gradients(function, inputs, **options):
    return torch.autograd.grad(function(*inputs), inputs, **options)


def assert_second_derivative(function, *inputs):
    """The gradient's derivative in a random direction, against differences of ordinary gradients."""
    generator = torch.Generator().manual_seed(0)
    inputs = [tensor.detach().requires_grad_() for tensor in inputs]
    ways = [torch.randn(x.shape, generator=generator, dtype=x.dtype).to(x.device) for x in inputs]
    first = gradients(function, inputs, create_graph=True)
    for have, want in zip(first, gradients(function, inputs), strict=True):
        torch.testing.assert_close(have, want)
    along = torch.stack([(slope * way).sum() for slope, way in zip(first, ways, strict=True)]).sum()
    second = torch.autograd.grad(along, inputs)
    step = 1e-5
    moved = ([x + sign * step * way for x, way in zip(inputs, ways, strict=True)] for sign in (1, -1))
    ahead, behind = (gradients(function, [x.detach().requires_grad_() for x in each]) for each in moved)
    for have, high, low in zip(second, ahead, behind, strict=True):
        want = (high - low) / (2 * step)
        assert want.abs().max() > 0
        torch.testing.assert_close(have, want, rtol=1e-5, atol=1e-7 * float(want.abs().max()) + 1e-9)


# --- the body: true second derivatives ---------------------------------------------------------------------------


@pytest.mark.parametrize("wanted", [*NAMES, "all"])
def test_second_derivatives_agree_with_finite_differences(device, wanted):
    parameters = random_parameters(3, 2, device)
    for name, parameter in zip(NAMES, parameters, strict=True):
        parameter.requires_grad_(wanted in (name, "all"))
    assert torch.autograd.gradcheck(everything, parameters, fast_mode=True)
    assert torch.autograd.gradgradcheck(everything, parameters, fast_mode=True)


def test_gradient_penalty_moves_what_stands_behind_the_body(device):
    """In training, parameters come from other numbers, and one of two arguments is a function of the other."""
    parameters = random_parameters(6, 2, device)

    def penalty(factor, create_graph=True):
        lengths = parameters[3] * factor
        thicknesses = lengths.mean() * parameters[4]
        posed = pose(*parameters[:3], lengths, thicknesses)
        value = posed.vertices(0).pow(3).sum() + posed.joints.pow(3).sum()
        slopes = torch.autograd.grad(value, (lengths, thicknesses), create_graph=create_graph)
        return torch.stack([slope.square().sum() for slope in slopes]).sum()

    factor = torch.tensor(1.1, dtype=torch.float64, device=device, requires_grad=True)
    (have,) = torch.autograd.grad(penalty(factor), factor)
    step = 1e-5
    high, low = (penalty((factor + sign * step).detach().requires_grad_(), create_graph=False) for sign in (1, -1))
    torch.testing.assert_close(have, (high - low) / (2 * step), rtol=1e-6, atol=0.0)


def test_the_third_derivative_agrees_with_finite_differences(device):
    orient, translation, rotations, lengths, thicknesses = random_parameters(7, 1, device)

    def slope_squared(lengths):
        parameters = (orient, translation * lengths.sum(), rotations, lengths, thicknesses)
        (slope,) = torch.autograd.grad(cubes(*parameters), lengths, create_graph=True)
        return slope.square().sum()

    assert_second_derivative(slope_squared, lengths)


def test_an_empty_batch_is_differentiated_twice(device):
    parameters = [tensor[:0].requires_grad_() for tensor in random_parameters(0, 1, device)]
    first = gradients(cubes, parameters, create_graph=True)
    torch.stack([slope.sum() for slope in first]).sum().backward()
    assert parameters[3].grad.shape == (0, 12)


def test_rotations_priors_cameras_and_metrics_are_differentiated_twice(device):
    turns = torch.randn(1, 20, 3, dtype=torch.float64).to(device) * 0.3
    six, up = (torch.randn(*shape, dtype=torch.float64).to(device) for shape in ((2, 6), (1, 3)))
    points = torch.randn(2, 5, 3, dtype=torch.float64).to(device) + torch.tensor([0.0, 0.0, 5.0]).to(device)
    pair, pairs = six[:, 0].exp(), six[:, :2].exp()
    prior = PosePrior().to(device, torch.float64)
    assert_second_derivative(lambda x: rotation_from_axis_angle(x).pow(3).sum(), turns)
    assert_second_derivative(lambda x: rotation_from_axis_angle(x).pow(3).sum(), turns * 0)
    assert_second_derivative(lambda x: rotation_from_6d(x).pow(3).sum(), six)
    assert_second_derivative(lambda x: rotation_to_axis_angle(x).pow(3).sum(), rotation_from_axis_angle(turns))
    assert_second_derivative(lambda x, y: prior(x, y).sum(), turns, up)
    assert_second_derivative(lambda x: prior.joint_limits(x).sum(), turns * 6)
    assert_second_derivative(lambda s, t, x: WeakPerspective(s, t).project(x).square().sum(), pair, six[:, :2], points)
    assert_second_derivative(lambda f, c, x: Perspective(f, c).project(x).square().sum(), pairs, six[:, 2:4], points)
    assert_second_derivative(lambda x: mpjpe(x, points.roll(1, 1)).sum(), points)
    assert_second_derivative(lambda x: pa_mpjpe(x, points.roll(1, 1)).sum(), points)


def test_a_detailed_model_is_differentiated_twice(device):
    model = anny(torch.device(device), torch.float64)
    orient, translation, rotations, lengths, thicknesses = random_parameters(8, 1, device)
    shape = torch.randn(1, model.num_shapes, dtype=torch.float64).to(device) * 0.3

    def clothed(shape, turns, lengths):
        posed = pose(orient, translation, rotation_from_axis_angle(turns), lengths, thicknesses)
        local, place = pose_from_ellipbody(model, posed, shape)
        return model.pose(shape, local, place).vertices.square().mean()

    turns = rotation_to_axis_angle(rotations) * 0.2
    assert_second_derivative(clothed, shape, turns, lengths)


# --- torch.func ---------------------------------------------------------------------------------------------------


def test_torch_func_agrees_with_autograd_on_the_body(device):
    parameters = random_parameters(9, 2, device)
    leaves = [tensor.clone().requires_grad_() for tensor in parameters]
    want = gradients(cubes, leaves)
    have = torch.func.grad(cubes, argnums=(0, 1, 2, 3, 4))(*parameters)
    for one, other in zip(have, want, strict=True):
        torch.testing.assert_close(one, other)

    def of_lengths(lengths):
        return cubes(*parameters[:3], lengths, parameters[4])

    hessian = torch.autograd.functional.hessian(of_lengths, parameters[3])
    torch.testing.assert_close(torch.func.hessian(of_lengths)(parameters[3]), hessian)
    torch.testing.assert_close(torch.func.jacrev(torch.func.grad(of_lengths))(parameters[3]), hessian)
    several = [torch.stack([tensor, tensor.flip(0)]) for tensor in parameters]
    together = torch.func.vmap(lambda *each: pose(*each).vertices(1))(*several)
    torch.testing.assert_close(together[1], pose(*parameters).vertices(1).flip(0))


# --- what is drawn: an error --------------------------------------------------------------------------------------


@pytest.fixture
def drawn(device) -> dict[str, tuple[Callable[[torch.Tensor], torch.Tensor], torch.Tensor]]:
    """Each public function has a loss of its gradient's input, and that input."""
    scene = Scene.make(0, device, batch=2, size=(24, 20))
    (vertices,), (centres, *shape) = (
        [leaf.detach() for leaf in scene.leaves(renderer)] for renderer in ("mesh", "coverage")
    )
    return {
        "draw_mesh": (lambda v: scene.draw("mesh", [v], num_maps=20).maps.square().sum(), vertices),
        "mesh_label_loss": (lambda v: scene.loss("mesh", [v])[0].sum(), vertices),
        "draw_ellipsoids": (lambda c: scene.draw("coverage", [c, *shape], num_maps=20).maps.square().sum(), centres),
        "ellipsoid_label_loss": (lambda c: scene.loss("coverage", [c, *shape])[0].sum(), centres),
    }


DRAWN = ["draw_mesh", "mesh_label_loss", "draw_ellipsoids", "ellipsoid_label_loss"]


@pytest.mark.parametrize("name", DRAWN)
def test_a_second_derivative_of_a_picture_is_an_error(drawn, name):
    loss, given = drawn[name]
    leaf = given.clone().requires_grad_()
    (first,) = gradients(loss, [leaf])
    assert first.abs().max() > 0
    (again,) = gradients(loss, [leaf], create_graph=True)
    torch.testing.assert_close(again, first, rtol=1e-4, atol=1e-4)
    for try_it in (
        lambda: again.square().sum().backward(),
        lambda: torch.autograd.functional.hessian(loss, given),
        lambda: gradients(lambda x: gradients(lambda y: loss(y).square(), [x], create_graph=True)[0].sum(), [leaf]),
    ):
        with pytest.raises(NotImplementedError, match=f"^{name}: differentiated twice; expected once"):
            try_it()


@pytest.mark.parametrize("name", DRAWN)
@pytest.mark.parametrize(
    "transform",
    [torch.func.grad, torch.func.jacrev, torch.func.hessian, torch.func.vmap],
    ids=["grad", "jacrev", "hessian", "vmap"],
)
def test_torch_func_on_a_picture_is_an_error(drawn, name, transform):
    loss, given = drawn[name]
    if transform is torch.func.vmap:
        given = torch.stack([given, given])
    with pytest.raises(NotImplementedError, match=rf"^{name}: called under torch\.func; expected plain tensors"):
        transform(loss)(given)


def test_torch_func_on_targets_is_an_error(device):
    targets = torch.zeros(3, 1, 8, 8, dtype=torch.uint8, device=device)
    with pytest.raises(NotImplementedError, match=r"^mesh_label_loss: called under torch\.func"):
        torch.func.vmap(lambda target: loss_on_screen(*triangle(device), target)[0])(targets)
    with pytest.raises(NotImplementedError, match=r"^ellipsoid_label_loss: called under torch\.func"):
        torch.func.vmap(lambda target: ellipsoid_label_loss(*ball(device=device), target)[0])(targets)


def test_a_second_derivative_of_a_registration_is_an_error(device):
    model = anny(torch.device(device))
    posed = ellipbodies(device)
    parts, areas = vertex_parts(model)
    vertices = (model.rest_vertices.expand(2, -1, -1) + posed.joints[:, :1]).requires_grad_()
    fit, inside = registration_costs(vertices, parts, areas, posed, 0.03)
    (first,) = torch.autograd.grad(fit.sum() + inside.sum(), vertices, create_graph=True)
    with pytest.raises(NotImplementedError, match=r"^register: differentiated twice"):
        first.sum().backward()
