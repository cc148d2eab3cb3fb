"""The accuracy benchmark reads what it says; what it measures is in docs/explanation/fitting.md."""

from __future__ import annotations

from warp_partdr.lab.measurements.accuracy import SUPERVISIONS, read_example


def test_example_is_read() -> None:
    sample = read_example()
    assert sample.joints is not None
    assert sample.joints.shape == (14, 3)
    assert sample.parts is not None
    assert sample.target is sample.parts.groups


def test_every_supervision_sees_what_its_name_says() -> None:
    sample = read_example()
    assert sample.parts is not None
    for name, method in SUPERVISIONS.items():
        seen = method.see(sample.parts)
        groups = 0 if seen is None else seen.label_set.num_groups
        assert groups == (0 if "keypoints" in name else 1 if "silhouette" in name else 14), name
