"""The index of the formula book: from an equation's number to its function, kernel, torch function and test.

Names are those of the package: ``body.posing.pose`` is ``warp_partdr.body.posing.pose``.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Equation:
    """One numbered equation of the paper.

    Attributes:
        title: A few words.
        formula: The paper's, as plain text; ^ is a superscript, _ a subscript, and a hat marks the truth.
        book: The function of this book, whose docstring tells the letters and the differences from the paper.
        kernels: Warp kernels and device functions; none where torch alone does it.
        torch: The functions that users call.
        tests: File and name, of tests that hold kernels and torch functions to the book.
    """

    title: str
    formula: str
    book: str
    kernels: tuple[str, ...]
    torch: tuple[str, ...]
    tests: tuple[str, ...]


_LABEL_LOSSES = ("render.mesh.mesh_label_loss", "render.ellipsoids.ellipsoid_label_loss")
_GRADIENT_TESTS = (
    "tests/render/test_mesh.py::test_dense_gradient_is_the_reference",
    "tests/render/test_ellipsoids.py::test_partdr_gradient_of_maps_is_the_reference",
)
_PICTURE_TEST = "tests/render/test_mesh.py::test_forward_is_the_reference"
_BODY_TEST = "tests/body/test_posing.py::test_pose_is_the_walk"
_ENERGY_TEST = "tests/reference/test_losses.py::test_energy_is_the_books"
_CLOTHING_TEST = "tests/reference/test_clothing.py::test_registration_terms_are_the_books"

EQUATIONS: dict[int, Equation] = {
    3: Equation(
        title="learning objective",
        formula="L = λ_3D L_3D + λ_proj L_proj + λ_seg L_seg",
        book="losses.learning_objective",
        kernels=(),
        torch=("training.task.weighted_losses",),
        tests=("tests/reference/test_losses.py::test_training_loss_is_the_books",),
    ),
    4: Equation(
        title="joints in 3D",
        formula="L_3D = ‖S - Ŝ‖²",
        book="losses.joint_loss",
        kernels=(),
        torch=("training.picture_losses.body_terms",),
        tests=("tests/reference/test_losses.py::test_training_terms_are_the_books",),
    ),
    5: Equation(
        title="projected joints",
        formula="L_proj = ‖S_2D - Ŝ_2D‖_1",
        book="losses.projection_loss",
        kernels=("kernels.refine.costs.pull_landmark",),
        torch=("refinement.energy.Energy.reprojection", "training.picture_losses.body_terms"),
        tests=(_ENERGY_TEST, "tests/reference/test_losses.py::test_training_terms_are_the_books"),
    ),
    6: Equation(
        title="part segmentation",
        formula="L_seg = Σ_k Σ_i Σ_j ‖A^k_(i,j) - Â^k_(i,j)‖²",
        book="losses.segmentation_loss",
        kernels=("kernels.mesh.rasterize.compare_labels", "kernels.labels.gradient_at"),
        torch=_LABEL_LOSSES,
        tests=(
            "tests/reference/test_losses.py::test_label_losses_are_the_books",
            "tests/render/test_mesh.py::test_label_loss_gradient_is_the_reference_on_ellipbody",
        ),
    ),
    8: Equation(
        title="face-index map",
        formula="F(u, v) = argmin_i D_(u,v)(f^i_j) if a face covers (u, v), else -1",
        book="mesh.face_index_map",
        kernels=("kernels.mesh.rasterize.draw_faces", "kernels.ellipsoids.picture.draw_rows"),
        torch=("render.mesh.draw_mesh", "render.ellipsoids.draw_ellipsoids"),
        tests=(_PICTURE_TEST, "tests/render/test_ellipsoids.py::test_picture_is_the_reference"),
    ),
    9: Equation(
        title="part maps",
        formula="A^i(u, v) = A(u, v) if F(u, v) = i, else 0",
        book="mesh.part_maps",
        kernels=("kernels.mesh.rasterize.resolve_keys",),
        torch=("render.mesh.draw_mesh", "render.ellipsoids.draw_ellipsoids"),
        tests=("tests/reference/test_partdr.py::test_part_maps_are_the_books", _PICTURE_TEST),
    ),
    10: Equation(
        title="derivative in x and y",
        formula="∂I_P/∂x = δI_P / (x0 - x1)",
        book="partdr.switch_slope",
        kernels=("kernels.mesh.push_xy.push_edges", "kernels.ellipsoids.partdr.walk_line"),
        torch=_LABEL_LOSSES,
        tests=("tests/reference/test_partdr.py::test_a_line_of_pixels_by_hand", *_GRADIENT_TESTS),
    ),
    11: Equation(
        title="occlusion in x and y",
        formula="∂I_P/∂x = 0 if A(u, v) > 0 and F(u, v) ≠ i, else eq. 10",
        book="partdr.switches_on",
        kernels=("kernels.mesh.push_xy.reach_out", "kernels.ellipsoids.partdr.walk_line"),
        torch=_LABEL_LOSSES,
        tests=("tests/reference/test_partdr.py::test_other_parts_end_no_walk", *_GRADIENT_TESTS),
    ),
    12: Equation(
        title="derivative in z",
        formula="∂I_P/∂z = λ δI_P log(Δ(M0, Q) / (Δ(M0, v_k) Δz) + 1)",
        book="partdr.depth_slope",
        kernels=("kernels.mesh.push_z.push_depths", "kernels.ellipsoids.partdr.push_depth"),
        torch=_LABEL_LOSSES,
        tests=("tests/reference/test_partdr.py::test_depth_slopes_by_hand", *_GRADIENT_TESTS),
    ),
    13: Equation(
        title="EllipBody",
        formula="𝔼 = {E_i : i = 1, ..., 20}",
        book="ellipbody.ellipsoids_of",
        kernels=("kernels.kinematics.pose_bones",),
        torch=("body.posing.pose",),
        tests=(_BODY_TEST,),
    ),
    14: Equation(
        title="ellipsoid",
        formula="E_i = E(R_i, C_i, l_i, t¹_i, t²_i)",
        book="ellipbody.deform_sphere",
        kernels=("kernels.kinematics.place_vertices",),
        torch=("body.posing.Posed.vertices",),
        tests=(_BODY_TEST,),
    ),
    15: Equation(
        title="skeleton",
        formula="S_i = R_parent(i) (l_i O_i) + S_parent(i)",
        book="ellipbody.place_joints",
        kernels=("kernels.kinematics.pose_bones", "kernels.refine.pose.place_part"),
        torch=("body.posing.pose",),
        tests=(_BODY_TEST,),
    ),
    16: Equation(
        title="registration",
        formula="(θ, β) = argmin L_ICP(M^S, M^E) + L_PEN(v^S, M^E)",
        book="registration.registration_loss",
        kernels=("kernels.registration.closest_on_cells", "kernels.registration.vertex_costs"),
        torch=("clothing.registration.register",),
        tests=(_CLOTHING_TEST,),
    ),
    17: Equation(
        title="distance to an ellipsoid",
        formula="e(v, E_i) = ‖2 d_x / l_i, 2 d_y / t¹_i, 2 d_z / t²_i‖",
        book="registration.radial_distance",
        kernels=("kernels.registration.radius", "kernels.registration.vertex_costs"),
        torch=("clothing.surfaces.surface_samples", "clothing.registration.register"),
        tests=("tests/reference/test_clothing.py::test_samples_within_another_ellipsoid_do_not_count", _CLOTHING_TEST),
    ),
    18: Equation(
        title="penetration",
        formula="L_PEN = Σ_(v,E) a (1 - e(v, E_i))²",
        book="registration.penetration_loss",
        kernels=("kernels.registration.vertex_costs",),
        torch=("clothing.registration.register",),
        tests=(_CLOTHING_TEST,),
    ),
    19: Equation(
        title="refinement's energy",
        formula="E(r, l, t, c) = λ_seg L_seg + λ_proj L_proj + λ_l L_l + λ_t L_t",
        book="losses.refinement_energy",
        kernels=("kernels.refine.rules.hold_length", "kernels.refine.rules.hold_thickness"),
        torch=("refinement.energy.Energy",),
        tests=(_ENERGY_TEST,),
    ),
}
