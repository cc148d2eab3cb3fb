"""Names of keypoints mean the right landmarks, in whatever spelling and order."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from warp_partdr.body.keypoint_names import landmark_of_name, left_out, left_out_warning, skeleton_of_names
from warp_partdr.body.landmarks import LANDMARKS, annotated
from warp_partdr.body.skeletons import SKELETONS
from warp_partdr.errors import InputError

COCO = SKELETONS["coco17"]
AP10K = (
    "left_eye right_eye nose neck root_of_tail left_shoulder left_elbow left_front_paw right_shoulder right_elbow "
    "right_front_paw left_hip left_knee left_back_paw right_hip right_knee right_back_paw"
).split()


@pytest.mark.parametrize(
    ("landmark", "spellings"),
    [
        (
            "left_shoulder",
            "Left Shoulder;LEFT_SHOULDER;leftShoulder;LShoulder;L_Shoulder;shoulder.l;lSho",
        ),
        ("right_ankle", "R_Ankle;rightAnkle;RAnkle;ankle_r;Ankle-R;Right ankle joint;16: right_ankle;rightankle"),
        ("left_hip", "Hip_L;LHip;left hip;coco_left_hip;person_left_hip"),
        ("right_eye", "REye;right-eye;r.eye;eye (right)"),
        ("left_ear", "LEar;left ear"),
        ("left_wrist", "l.wrist;LWrist;Wrist L"),
        ("right_big_toe", "RBigToe;right_bigtoe;Right Big Toe"),
        ("left_small_toe", "LSmallToe;left little toe;left_pinky_toe"),
        ("right_heel", "RHeel;heel right"),
        ("mouth_left", "mouth_left;left_mouth;Left mouth corner;face-54"),
        ("right_eye_inner", "right_eye_inner;face-39"),
        ("left_thumb", "left_thumb;left_thumb3"),
        ("head_top", "head_top;top_head;Top of head;HeadTop;crown;head top"),
        ("head", "upper neck;UpperNeck;upper_neck"),
        ("neck", "Neck;thorax;head_bottom;head bottom;lower neck"),
        ("mid_hip", "pelvis;MidHip;mid hip;root;Hip;hip center;hips"),
        (None, "left;hand;left_hand;right_foot;tail;shoulder;knee;left_right_eye;heel;hat;spine2;left_hand_root;7;"),
    ],
)
def test_landmarks_are_known_by_any_spelling_of_their_names(landmark: str | None, spellings: str) -> None:
    for name in spellings.split(";"):
        assert landmark_of_name(name) == landmark, name


def test_letters_glued_to_a_name_need_their_mirror_image() -> None:
    assert landmark_of_name("rear") is None
    assert landmark_of_name("rear", ["lear", "rear"]) == "right_ear"
    assert landmark_of_name("lknee", ["rknee"]) == "left_knee"
    assert landmark_of_name("kneel") is None


@pytest.mark.parametrize("name", list(SKELETONS))
def test_every_formats_own_names_give_it(name: str) -> None:
    this = SKELETONS[name]
    names = [f"{row} kp" for row in range(this.count)]
    for row, landmark in zip(this.places, this.landmarks, strict=True):
        names[row] = landmark
    form = skeleton_of_names(names, "f")
    if name == "body135":  # whose landmarks are those of body25b
        names[this.landmarks.index("head")] = "upper_neck"
        form = skeleton_of_names(names, "f")
        assert form is not None
        assert (form.landmarks, form.places, form.count) == (this.landmarks, this.places, 135)
    elif name == "shelf14":  # whose names are LSP's, in the same order
        assert form is SKELETONS["lsp14"]
    else:
        assert form is this
    assert len(left_out(names, form)) == this.count - len(this)


@given(st.permutations(range(17)))
def test_order_does_not_matter(order: list[int]) -> None:
    names = [COCO.landmarks[joint].upper() for joint in order]
    form = skeleton_of_names(names, "f")
    assert form is not None
    assert (form.name, form.landmarks, form.marks, form.edges) == (COCO.name, COCO.landmarks, COCO.marks, COCO.edges)
    assert [names[row].lower() for row in form.places] == [*COCO.landmarks]


def test_formats_that_share_their_landmarks_are_told_apart_by_order() -> None:
    for name in ("lsp14", "crowdpose14", "aic14"):
        assert skeleton_of_names(SKELETONS[name].landmarks, "f") is SKELETONS[name]
    mixed = skeleton_of_names(SKELETONS["lsp14"].landmarks[::-1], "f")
    assert mixed is not None
    assert mixed.marks == SKELETONS["crowdpose14"].marks  # what annotators mark, for of lists they are the likelier


def test_names_mean_what_their_data_set_calls_by_them() -> None:
    """The same name may be another landmark beside other names: ``head`` is the crown in CrowdPose, and not in SMPL."""
    crowd = "left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist left_hip right_hip".split()
    legs = "left_knee right_knee left_ankle right_ankle".split()
    assert skeleton_of_names([*crowd, *legs, "head", "neck"], "f") is SKELETONS["crowdpose14"]
    mpii = "rank rkne rhip lhip lkne lank pelvis thorax upper_neck head_top rwri relb rsho lsho lelb lwri".split()
    assert skeleton_of_names(mpii, "f") is SKELETONS["mpii16"]
    for middle in ("root {} spine thorax neck_base head {}", "Hip {} Spine Thorax Neck/Nose Head {}"):
        right, left = (f"{side}_hip {side}_knee {side}_foot" for side in ("right", "left"))
        arms = "left_shoulder left_elbow left_wrist right_shoulder right_elbow right_wrist"
        assert skeleton_of_names(middle.format(f"{right} {left}", arms).split(), "f") is SKELETONS["h36m17"]
    smpl = skeleton_of_names(
        ["pelvis", "spine3", "neck", "head", "left_collar", "right_collar", "left_hip", "right_hip"], "f"
    )
    assert smpl is not None
    assert smpl.places[smpl.landmarks.index("head")] == 3
    assert "head_top" not in smpl.landmarks
    two = ["head", "head_top", "nose", "left_hip", "right_hip", "neck", "thorax"]
    form = skeleton_of_names(two, "f")
    assert form is not None
    assert left_out(two, form) == ["head", "neck"]
    assert form.places[form.landmarks.index("neck")] == 6


def test_names_of_no_known_format_make_a_skeleton_with_both_sides() -> None:
    """The skeleton has the other side of each landmark, too."""
    form = skeleton_of_names(["hat", "right_wrist", "nose"], "f")
    assert form is not None
    assert (form.name, form.landmarks, form.places) == ("named", ("nose", "left_wrist", "right_wrist"), (2, -1, 1))
    assert left_out_warning(["hat", "right_wrist", "nose"], form) == (
        "keypoints: hat left out; expected names of landmarks of the body"
    )
    odd = skeleton_of_names(["spine", "left_eye", "left_hip"], "f")
    assert odd is not None
    assert odd.name == "named"
    assert odd.landmarks == ("spine", "left_eye", "right_eye", "left_hip", "right_hip")
    assert odd.marks == annotated(odd.landmarks)
    assert odd.places == (0, 1, -1, 2, -1)
    assert odd.mirror.tolist() == [0, 2, 1, 4, 3]


def test_names_that_are_not_of_a_person_are_refused() -> None:
    with pytest.raises(InputError, match=r"^f: keypoint 'root_of_tail'; expected keypoints of people, not of animals"):
        skeleton_of_names(AP10K, "f")
    for name in ("L_F_Paw", "TailBase", "withers", "beak", "left front hoof"):
        with pytest.raises(InputError, match="not of animals"):
            skeleton_of_names([*COCO.landmarks, name], "f")
    hand = ["wrist", *(f"thumb{n}" for n in range(4)), "left_eye", "right_eye"]
    with pytest.raises(
        InputError, match=r"^f: 2 of 7 keypoint names are landmarks of a person \(wrist, thumb0, .* and 3"
    ):
        skeleton_of_names(hand, "f")
    with pytest.raises(InputError, match=r"^f: 1 of 1 keypoint names"):
        skeleton_of_names(["nose"], "f")
    with pytest.raises(InputError, match=r"^f: keypoint name 1: 3; expected text"):
        skeleton_of_names(["nose", 3], "f")


def test_numbers_are_no_names() -> None:
    for names in (["0", "1", "2"], ["kp_1", "kp_2"], ["new-point-0", "new-point-1"], ["keypoint 7", "P8"]):
        assert skeleton_of_names(names, "f") is None


@given(st.lists(st.text(max_size=12) | st.sampled_from(sorted(LANDMARKS)), min_size=1, max_size=30))
def test_any_names_make_a_skeleton_or_are_refused(names: list[str]) -> None:
    try:
        form = skeleton_of_names(names, "f")
    except InputError:
        return
    if form is not None:
        assert form.count == len(names)
        assert len(form.places) == len(form) == len(form.mirror)
        assert all(-1 <= row < len(names) for row in form.places)


def test_mpiis_short_names_are_mpii16_whatever_their_order() -> None:
    short = "rank rkne rhip lhip lkne lank pelv thrx neck head rwri relb rsho lsho lelb lwri".split()
    for names in (short, short[::-1]):
        form = skeleton_of_names(names, "mine")
        assert form is not None
        named = {names[place]: name for place, name in zip(form.places, form.landmarks, strict=True) if place >= 0}
        assert (named["pelv"], named["thrx"], named["head"]) == ("mid_hip", "neck", "head_top")
        assert named["lank"] == "left_ankle"
        assert "neck" not in named


@pytest.mark.parametrize("spelling", ["person1_{}", "p2_{}", "{} [13]", "{}_12", "person_3_{}", "{}-7"])
def test_numbers_of_people_and_points_around_a_name_are_left_out(spelling: str) -> None:
    for name in ("left_hip", "Right Knee"):
        assert landmark_of_name(spelling.format(name)) == name.lower().replace(" ", "_")


def test_numbers_that_tell_other_points_are_not_left_out() -> None:
    for name in ("spine2", "left_eye_3", "left_thumb_4", "C7"):
        assert landmark_of_name(name) is None
    numbered = ["nose_0", "left_eye_1", "right_eye_2"]
    assert [landmark_of_name(name, numbered) for name in numbered] == ["nose", "left_eye", "right_eye"]
