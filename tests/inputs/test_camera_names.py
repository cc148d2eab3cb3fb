"""Films are of the cameras that their names say, and nothing is paired that names contradict."""

from __future__ import annotations

import pytest

from warp_partdr.errors import InputError
from warp_partdr.inputs.camera_names import assign_cameras, natural_key


@pytest.mark.parametrize(
    ("films", "cameras", "expected"),
    [
        # Names that are equal, in any order, of some of the cameras.
        ("right left", "left middle right", "right left"),
        ("Cam02 CAM1", "cam1 cam2", "cam2 cam1"),
        ("01 03", "01 02 03", "01 03"),
        # One name is part of the other one.
        ("cam12_sync cam2_sync cam3_sync", "cam2 cam3 cam12", "cam12 cam2 cam3"),
        ("cam03 cam04", "int_cam04_img int_cam03_img", "int_cam03_img int_cam04_img"),
        ("take_right take_left", "left right", "right left"),
        ("camB_1080p camA_1080p", "A B", "B A"),
        ("hd_00_11 hd_00_02", "00_02 00_03 00_11", "00_11 00_02"),
        ("cam1_left_x cam1_y", "cam1 cam1_left", "cam1_left cam1"),
        # The number that tells the films apart.
        ("cam10 cam9", "9 10", "10 9"),
        ("view-03 view-01", "camera1 camera2 camera3", "camera3 camera1"),
        ("GX010045_cam2 GX010046_cam1", "cam_1 cam_2", "cam_2 cam_1"),
        ("2024-05-01_c2 2024-05-01_c1", "port_1 port_2", "port_2 port_1"),
        ("1_view2_a 2_view1", "cam1 cam2", "cam2 cam1"),
        ("trial_3_cam1", "cam3 cam1", "cam1"),
        ("GoPro4 GoPro3", "rig3 rig4", "rig4 rig3"),
        ("x_cam2 x_cam1", "rig1_cam2 rig2_cam1", "rig1_cam2 rig2_cam1"),
        ("view2 view1", "rig1_cam2 rig2_cam1", "rig1_cam2 rig2_cam1"),
        # Letters and sides.
        ("camD camC", "CameraC CameraD", "CameraD CameraC"),
        ("run1_viewd run1_viewc", "camc camd", "camd camc"),
        ("D C", "camC camD", "camD camC"),
        ("left_cam right_cam", "R L", "L R"),
        ("Right Left", "view-l view-r", "view-r view-l"),
        # Folders, nearest first, where files do not tell it.
        ("c2/film c1/film", "cam1 cam2", "cam2 cam1"),
        ("cam7/GX019001 cam31/GX019002 cam8/GX019003", "cam7 cam8 cam31", "cam7 cam31 cam8"),
        ("r/port_2/100GOPRO/GP010044 r/port_1/100GOPRO/GP010045", "cam1 cam2", "cam2 cam1"),
        ("cam2/C0001 cam1/C0002", "cam1 cam2", "cam2 cam1"),
        ("front/IMG_2 back/IMG_1", "1_back 2_front", "2_front 1_back"),
        ("take1/cam2 take2/cam1", "cam1 cam2", "cam2 cam1"),
        ("cam2/VID_1", "cam1 cam2", "cam2"),
    ],
)
def test_names_say_whose_a_film_is(films: str, cameras: str, expected: str) -> None:
    found = assign_cameras([f"{film}.mp4" for film in films.split()], cameras.split())
    assert [cameras.split()[place] for place in found.cameras] == expected.split()
    assert not found.by_order
    assert not found.by_number


@pytest.mark.parametrize(
    ("films", "cameras", "expected"),
    [
        ("jump7_2 jump7_1", "1 2", "2 1"),
        ("a_2 b_x_1", "1 2", "2 1"),
        ("2023-11-30_09-15-04 2023-11-30_09-15-03", "cam3 cam4", "cam4 cam3"),
        ("C0002 C0001", "cam1 cam2", "cam2 cam1"),  # clips of a camera
        ("GP000002 GP000001", "1 2", "2 1"),
        ("hop3_D hop3_C", "camC camD", "camD camC"),
        ("hop_right hop_left", "cam1_L cam2_R", "cam2_R cam1_L"),
        ("day2/GX19 day1/GX18", "1 2", "2 1"),
    ],
)
def test_numbers_that_may_be_of_takes_are_told(films: str, cameras: str, expected: str) -> None:
    found = assign_cameras([f"{film}.mp4" for film in films.split()], cameras.split())
    assert [cameras.split()[place] for place in found.cameras] == expected.split()
    assert found.by_number
    assert not found.by_order


@pytest.mark.parametrize(
    ("films", "cameras", "expected"),
    [
        ("left right", "1 2", "1 2"),
        ("right left", "1 2", "1 2"),  # as given
        ("GX010045 GX010046", "cam1 cam2", "cam1 cam2"),
        ("take10 take9", "left right", "right left"),  # as a shell's * lists them
        ("take9 take10", "left right", "left right"),
        ("left_sync middle", "left right", "left right"),
        ("A B", "left right", "left right"),
        ("camA camB", "cam1 cam2", "cam1 cam2"),
        ("d10/x d9/y", "left right", "right left"),  # as a shell's */* lists them
        ("trial1_left trial1_right", "1 2", "1 2"),  # a number that all films have is no camera's
    ],
)
def test_names_that_say_nothing_leave_the_order_to_decide(films: str, cameras: str, expected: str) -> None:
    found = assign_cameras([f"{film}.mp4" for film in films.split()], cameras.split())
    assert [cameras.split()[place] for place in found.cameras] == expected.split()
    assert found.by_order


@pytest.mark.parametrize(
    ("films", "cameras", "how"),
    [
        ("cam1 cam2 cam3", "cam_0 cam_1 cam_2", "by the same numbers"),
        ("cam1 cam2", "cam_3 cam_4", "by the same numbers"),
        ("IMG_2 IMG_3", "cam1 cam2", "by the same numbers"),
        ("1_cam3 2_cam4", "cam1 cam2", "by the same numbers"),
        ("1_2 2_1", "1 2", "by numbers that fit in one way"),
        ("cam1_a cam1_b", "cam1 cam2", "by name, or as many in order"),
        ("right_sync middle", "left right", "by name, or as many in order"),
        ("left middle right", "1 2", "by name, or as many in order"),
        ("trial_3", "cam1 cam3", "by name, or as many in order"),
        ("hop_c", "C D", "by name, or as many in order"),
        ("camC camD", "camD camE", "by the same numbers"),
    ],
)
def test_names_that_contradict_are_refused(films: str, cameras: str, how: str) -> None:
    with pytest.raises(InputError, match=how) as error:
        assign_cameras([f"{film}.mp4" for film in films.split()], cameras.split())
    assert ", ".join(cameras.split()) in str(error.value)
    assert ", ".join(films.split()) in str(error.value)


def test_folders_that_contradict_are_refused() -> None:
    with pytest.raises(InputError, match="expected one a film: right, other, by name"):
        assign_cameras(["right/x.mp4", "other/y.mp4"], ["left", "right"])


def test_names_are_sorted_by_the_numbers_in_them() -> None:
    assert sorted(["b", "cam10", "cam9", "cam", "10", "2"], key=natural_key) == ["2", "10", "b", "cam", "cam9", "cam10"]
