"""People cut out of pictures, compared."""

from __future__ import annotations

import torch

from warp_partdr.cameras import Perspective
from warp_partdr.inputs.evidence import Evidence
from warp_partdr.inputs.observation import LABEL_SIZE, CutOut, crop_evidence


def assert_cut_as_alone(
    cut: CutOut, alone: Evidence, camera: Perspective | None, device: str = "cpu", size: int = LABEL_SIZE
) -> None:
    """Each part of a cut is, to the bit, what ``crop_evidence`` makes of the person's own evidence."""
    evidence, observation, crop = cut
    seen, expected_crop = crop_evidence(alone, camera=camera, label_size=size)
    assert crop == expected_crop
    assert (evidence.keypoints, evidence.window) == (alone.keypoints, alone.window)
    assert evidence.warnings == alone.warnings
    assert (observation.landmarks, observation.marks) == (seen.landmarks, seen.marks)
    assert observation.label_set == seen.label_set
    for name in ("points", "confidence", "labels", "lens"):
        ours, theirs = getattr(observation, name), getattr(seen, name)
        assert (ours is None) == (theirs is None), name
        if ours is not None:
            assert ours.device.type == device
            torch.testing.assert_close(ours.cpu(), theirs, rtol=0, atol=0, msg=name)
