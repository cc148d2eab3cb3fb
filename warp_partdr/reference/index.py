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
        formula: Plain text; ^ is a superscript, _ a subscript, and a hat marks the truth.
        letters: What they are.
        book: The function of this book.
        kernels: Warp kernels and device functions; none where torch alone does it.
        torch: The functions that users call.
        tests: File and name, of tests that hold kernels and torch functions to the book.
        note: Differences from the paper, and what it leaves open.
    """

    title: str
    formula: str
    letters: str
    book: str
    kernels: tuple[str, ...]
    torch: tuple[str, ...]
    tests: tuple[str, ...]
    note: str = ""


_LABEL_LOSSES = ("render.mesh.label_loss", "render.ellipsoids.ellipsoid_label_loss")
_GRADIENT_TESTS = (
    "tests/render/test_render.py::test_dense_gradient_is_the_reference",
    "tests/render/test_ellipsoids.py::test_partdr_gradient_of_maps_is_the_reference",
)
_PICTURE_TEST = "tests/render/test_render.py::test_forward_is_the_reference"
_BODY_TEST = "tests/body/test_posing.py::test_pose_is_the_walk"
_ENERGY_TEST = "tests/reference/test_losses.py::test_energy_is_the_books"
_CLOTHING_TEST = "tests/reference/test_clothing.py::test_registration_terms_are_the_books"

EQUATIONS: dict[int, Equation] = {
    3: Equation(
        title="learning objective",
        formula="L = λ_3D L_3D + λ_proj L_proj + λ_seg L_seg",
        letters="L_3D, L_proj, L_seg: eq. 4 to 6; λ: their weights, λ_3D = 0 for pictures without a truth in 3D",
        book="losses.learning_objective",
        kernels=(),
        torch=("training.picture_task.PictureTask.loss",),
        tests=("tests/reference/test_losses.py::test_training_loss_is_the_books",),
        note="Training adds L_l and L_t of eq. 19 and cross entropies of the network's heads.",
    ),
    4: Equation(
        title="joints in 3D",
        formula="L_3D = ‖S - Ŝ‖²",
        letters="S: joints of the body; Ŝ: the true ones",
        book="losses.joint_loss",
        kernels=(),
        torch=("training.picture_losses.body_terms",),
        tests=("tests/reference/test_losses.py::test_training_terms_are_the_books",),
        note="Centimetres; the mean over known joints, from the middle of the hips.",
    ),
    5: Equation(
        title="projected joints",
        formula="L_proj = ‖S_2D - Ŝ_2D‖_1",
        letters="S_2D: projected joints [px of a crop of 256 px]; Ŝ_2D: where they are seen",
        book="losses.projection_loss",
        kernels=("kernels.refine.costs.pull_landmark",),
        torch=("refinement.energy.Energy.reprojection", "training.picture_losses.body_terms"),
        tests=(_ENERGY_TEST, "tests/reference/test_losses.py::test_training_terms_are_the_books"),
        note="Each keypoint has a vote, its confidence; landmarks of one part share one.",
    ),
    6: Equation(
        title="part segmentation",
        formula="L_seg = Σ_k Σ_i Σ_j ‖A^k_(i,j) - Â^k_(i,j)‖²",
        letters="A^k: map of part k, 0 or 1 at pixel (i, j); Â^k: the wanted one; K parts, w × h pixels",
        book="losses.segmentation_loss",
        kernels=("kernels.mesh.rasterize.compare_labels", "kernels.labels.gradient_at"),
        torch=_LABEL_LOSSES,
        tests=(
            "tests/reference/test_losses.py::test_label_losses_are_the_books",
            "tests/render/test_render.py::test_label_loss_gradient_is_the_reference_on_ellipbody",
        ),
        note="From two label images, without maps; pixels of label 255 count nowhere.",
    ),
    8: Equation(
        title="face-index map",
        formula="F(u, v) = argmin_i D_(u,v)(f^i_j) if a face covers (u, v), else -1",
        letters="f^i_j: face j of part i; D: its depth at pixel (u, v)",
        book="mesh.face_index_map",
        kernels=("kernels.mesh.rasterize.draw_faces", "kernels.ellipsoids.picture.draw_rows"),
        torch=("render.mesh.rasterize_parts", "render.ellipsoids.draw_ellipsoids"),
        tests=(_PICTURE_TEST, "tests/render/test_ellipsoids.py::test_picture_is_the_reference"),
        note="A fill rule for centres on an edge; of equal depths the lower index.",
    ),
    9: Equation(
        title="part maps",
        formula="A^i(u, v) = A(u, v) if F(u, v) = i, else 0",
        letters="A: 1 where F > -1; F = i: the face that shows is of part i",
        book="mesh.part_maps",
        kernels=("kernels.mesh.rasterize.resolve_keys",),
        torch=("render.mesh.rasterize_parts", "render.ellipsoids.draw_ellipsoids"),
        tests=("tests/reference/test_partdr.py::test_part_maps_are_the_books", _PICTURE_TEST),
        note="Kernels write one image of labels; maps are made when asked for.",
    ),
    10: Equation(
        title="derivative in x and y",
        formula="∂I_P/∂x = δI_P / (x0 - x1)",
        letters="I_P: value of A^i at pixel P; δI_P: its change, ±1; x0: the edge's place; x1: where it meets P",
        book="partdr.switch_slope",
        kernels=("kernels.mesh.push_xy.push_edges", "kernels.ellipsoids.partdr.walk_line"),
        torch=_LABEL_LOSSES,
        tests=("tests/reference/test_partdr.py::test_a_line_of_pixels_by_hand", *_GRADIENT_TESTS),
        note="x1 - x0 here, at least a pixel. The paper moves vertices of every face, here silhouette edges move, and "
        "their ends get the shares that they have at the crossing. Any loss's gradient g may stand behind.",
    ),
    11: Equation(
        title="occlusion in x and y",
        formula="∂I_P/∂x = 0 if A(u, v) > 0 and F(u, v) ≠ i, else eq. 10",
        letters="(u, v): the pixel P; i: part of the edge",
        book="partdr.switches_on",
        kernels=("kernels.mesh.push_xy.reach_out", "kernels.ellipsoids.partdr.walk_line"),
        torch=_LABEL_LOSSES,
        tests=("tests/reference/test_partdr.py::test_other_parts_end_no_walk", *_GRADIENT_TESTS),
        note='0 on parts in front alone: what lies behind would be covered. The book has occlusion="paper", too.',
    ),
    12: Equation(
        title="derivative in z",
        formula="∂I_P/∂z = λ δI_P log(Δ(M0, Q) / (Δ(M0, v_k) Δz) + 1)",
        letters="Q: the hidden face's point at P; v_k: its vertex; M0: where the line through both meets the other "
        "side; Δ: length; Δz: depth between the two faces; λ: a weight",
        book="partdr.depth_slope",
        kernels=("kernels.mesh.push_z.push_depths", "kernels.ellipsoids.partdr.push_depth"),
        torch=_LABEL_LOSSES,
        tests=("tests/reference/test_partdr.py::test_depth_slopes_by_hand", *_GRADIENT_TESTS),
        note="w log(1 / Δz + 1), with w the barycentric weight; Δz is at least 0.1 mm; the hiding face goes back by as "
        "much.",
    ),
    13: Equation(
        title="EllipBody",
        formula="𝔼 = {E_i : i = 1, ..., 20}",
        letters="E_i: an ellipsoid",
        book="ellipbody.ellipsoids_of",
        kernels=("kernels.kinematics.pose_bones",),
        torch=("body.posing.pose",),
        tests=(_BODY_TEST,),
        note="The pelvis is two of the 20. C_i is the bone's middle, as the paper says below eq. 14.",
    ),
    14: Equation(
        title="ellipsoid",
        formula="E_i = E(R_i, C_i, l_i, t¹_i, t²_i)",
        letters="E: moves the icosahedron's vertices; R_i: rotation; C_i: centre; l_i: length; t_i: thicknesses",
        book="ellipbody.deform_sphere",
        kernels=("kernels.kinematics.place_vertices",),
        torch=("body.posing.Posed.vertices",),
        tests=(_BODY_TEST,),
        note="l and t are full widths, as eq. 17 has them.",
    ),
    15: Equation(
        title="skeleton",
        formula="S_i = R_parent(i) (l_i O_i) + S_parent(i)",
        letters="S_i: joint i; R: global rotation; l_i: length; O_i: direction from its parent, a unit vector",
        book="ellipbody.place_joints",
        kernels=("kernels.kinematics.pose_bones", "kernels.refine.pose.place_part"),
        torch=("body.posing.pose",),
        tests=(_BODY_TEST,),
        note="Rotations are counted by bones: the paper's R_parent(i) is the bone's own.",
    ),
    16: Equation(
        title="registration",
        formula="(θ, β) = argmin L_ICP(M^S, M^E) + L_PEN(v^S, M^E)",
        letters="θ, β: pose and shape of the detailed body; M^S: its mesh, with vertices v^S; M^E: EllipBody",
        book="registration.registration_loss",
        kernels=("kernels.registration.closest_on_cells", "kernels.registration.vertex_costs"),
        torch=("clothing.registration.register",),
        tests=(_CLOTHING_TEST,),
        note="ICP is point to plane, both ways, and robust; register adds joints, measures and priors.",
    ),
    17: Equation(
        title="distance to an ellipsoid",
        formula="e(v, E_i) = ‖2 d_x / l_i, 2 d_y / t¹_i, 2 d_z / t²_i‖",
        letters="v: a vertex; d = R_i^-1 (v - C_i)",
        book="registration.radial_distance",
        kernels=("kernels.registration.radius", "kernels.registration.vertex_costs"),
        torch=("clothing.registration.surface_samples", "clothing.registration.register"),
        tests=("tests/reference/test_clothing.py::test_samples_within_another_ellipsoid_do_not_count", _CLOTHING_TEST),
    ),
    18: Equation(
        title="penetration",
        formula="L_PEN = Σ_(v,E) a (1 - e(v, E_i))²",
        letters="a: 0 where e > 1, else 1",
        book="registration.penetration_loss",
        kernels=("kernels.registration.vertex_costs",),
        torch=("clothing.registration.register",),
        tests=(_CLOTHING_TEST,),
        note="Vertices count by the skin around them.",
    ),
    19: Equation(
        title="refinement's energy",
        formula="E(r, l, t, c) = λ_seg L_seg + λ_proj L_proj + λ_l L_l + λ_t L_t",
        letters="L_l = ‖l - l_mean‖² and L_t = ‖t - t_mean‖² [mm²]; r: rotations; l: 12 lengths; t: 15 thicknesses; "
        "c: camera; λ: weights",
        book="losses.refinement_energy",
        kernels=("kernels.refine.costs.cost_rules",),
        torch=("refinement.energy.Energy",),
        tests=(_ENERGY_TEST,),
        note="Fits add a pose prior, joint limits and a hold in depth.",
    ),
}
