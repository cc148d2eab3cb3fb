"""A fit says what it models and what it leaves out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from helpers.bodies import TIPS, WITHOUT_TIPS, bent_bodies, seen_by
from helpers.files import EXAMPLE
from helpers.quick import QUICK_SEARCH
from rich.console import Console
from typer.testing import CliRunner

from warp_partdr import label_set
from warp_partdr.body.labels import LabelSet
from warp_partdr.cameras import Perspective
from warp_partdr.cli import main
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.models.anny import anny
from warp_partdr.models.reduction import reduce_model
from warp_partdr.solve.ellipsoids.explain import explain, explain_mesh, print_choices
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.stages import Stage
from warp_partdr.solve.mesh.mesh_options import MeshOptions


def seen(labels: LabelSet) -> tuple[Keypoints2D, PartLabels]:
    """Keypoints, the face's without confidence, and labels of a body at the edge of a picture."""
    keypoints, parts = seen_by(bent_bodies(batch=1))
    confidence = np.ones(17, dtype=np.float32)
    confidence[:3] = 0.0
    groups = np.pad(labels.from_parts(parts.groups), ((0, 100), (0, 240)))
    return replace(keypoints, confidence=confidence), PartLabels(labels, groups)


def test_a_fit_says_what_it_models():
    keypoints, parts = seen(WITHOUT_TIPS)
    choices = {choice.what: choice for choice in explain(keypoints, parts)}
    assert choices["keypoints"].modelled.startswith("14 of 17")
    assert choices["keypoints"].left_out == "nose; left_eye; right_eye"
    assert choices["ellipsoids"].modelled == "16 of 20 drawn"
    assert set(choices["ellipsoids"].left_out.split("; ")) == set(TIPS)
    assert 50 < float(choices["picture"].left_out.split()[0]) < 95
    assert choices["groups of parts"].left_out == ""
    assert "16 maps" in choices["L_seg"].left_out
    assert choices["z gradient"].modelled == ""
    assert choices["start"].modelled == "the label network's body"
    assert choices["an iteration"].left_out == "autograd, Python"


def test_a_fit_without_labels_draws_nothing():
    keypoints, _ = seen(label_set("body14"))
    last = explain(keypoints)[-1]
    assert last.what == "part labels"
    assert last.left_out == "L_seg"
    searched = explain(keypoints, options=FitOptions.at("balanced", "search"))
    assert "labels, fine" in searched[-1].left_out
    choices = {choice.what: choice for choice in searched}
    assert choices["start"].left_out == "the label network"
    assert choices["camera"].left_out.startswith("distance")
    unrefined = explain(*seen(label_set("body14")), options=FitOptions(stages=()))
    assert unrefined[-1].why == "no stage draws"
    sized = replace(keypoints, image_size=(480, 640))
    assert explain(sized)[1].modelled.startswith("a usual lens, 1 times")
    weak = explain(sized, options=FitOptions(guess_camera=False))
    assert weak[1].modelled.startswith("weak perspective")
    known = explain(keypoints, camera=Perspective.of_picture((480, 640), focal=500))
    assert known[1].modelled == "perspective, focal length 500 px"


def test_a_fit_says_when_it_tries_limbs_mirrored_in_depth():
    for labels, options, tried, why in (
        (WITHOUT_TIPS, FitOptions(), True, "overlap"),
        (WITHOUT_TIPS, QUICK_SEARCH, False, "hypotheses"),
        (label_set("full1"), FitOptions(), False, "one label"),
    ):
        keypoints, parts = seen(labels)
        choices = {choice.what: choice for choice in explain(keypoints, parts, options=options)}
        assert bool(choices["depth order"].modelled) == tried
        assert why in choices["depth order"].why
        assert (fit_body(keypoints, parts, options=options).depth_order is not None) == tried


def test_a_fit_says_where_it_looks_for_depth():
    for labels, modelled, why in ((WITHOUT_TIPS, "stages labels, coarse", ""), (label_set("full1"), "", "one label")):
        keypoints, parts = seen(labels)
        choices = explain(keypoints, parts, options=FitOptions.at("balanced", "search"))
        depth = next(choice for choice in choices if choice.what == "z gradient")
        assert depth.modelled.startswith(modelled)
        assert bool(depth.modelled) == bool(modelled)
        assert why in depth.why


def test_the_table_holds_every_choice(capsys):
    keypoints, parts = seen(WITHOUT_TIPS)
    choices = explain(keypoints, parts)
    print_choices(choices, Console(width=200))
    shown = capsys.readouterr().out
    assert all(choice.what in shown for choice in choices)


def test_fits_of_a_few_stages_still_fit():
    """The stages and the crop that are explained are those that are taken."""
    keypoints, parts = seen(WITHOUT_TIPS)
    options = FitOptions(stages=(Stage("lift", 8, 5, 0.1), Stage("labels", 2, 3, 0.02, 64)))
    result = fit_body(keypoints, parts, options=options)
    picture = next(choice for choice in explain(keypoints, parts, options=options) if choice.what == "picture")
    assert picture.modelled == f"{256 / result.crop.zoom:.0f} x {256 / result.crop.zoom:.0f} px around the person, " + (
        "drawn at 64 px"
    )


def test_the_command_explains(tmp_path):
    inputs = [str(EXAMPLE / "photo.png"), "--keypoints", str(EXAMPLE / "keypoints.json")]
    run = CliRunner().invoke(main.app, ["fit", *inputs, "--explain", "--model", "none", "--out", str(tmp_path / "fit")])
    assert run.exit_code == 0, run.output
    assert "What is modelled" in run.output


def test_of_the_detailed_body_it_says_what_is_drawn():
    _, parts = seen(label_set("body14"))
    drawn, alone = (explain_mesh(anny(), given, MeshOptions()) for given in (parts, None))
    assert (drawn.modelled, drawn.left_out) == (
        "1,507 vertices and thicknesses of clothes, drawn against the labels",
        "12,211 until the end: fingers, toes, face",
    )
    assert alone.left_out == "the mesh stage"
    few = reduce_model(anny(), 500).model
    assert explain_mesh(few, parts, MeshOptions()).left_out == ""
