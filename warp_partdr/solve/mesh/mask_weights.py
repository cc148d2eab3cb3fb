"""Weights of keypoints and labels where the labels of a picture are one mask of the whole person.

A mask shows hair, clothes and bags that a body lacks, and it has no borders between parts. A fit that trusts it as much
as part labels brings heads and shoulders nearer to the camera, where they cover more of the mask. The factors were
chosen on 48 free photos of real people and on photos with a true pose (docs/measured/hard_situations.md).
"""

from __future__ import annotations

from typing import NamedTuple


class MaskWeights(NamedTuple):
    """Factors of the weights of L_proj and L_seg."""

    proj: float
    seg: float


PART_LABELS = MaskWeights(proj=1.0, seg=1.0)
ONE_MASK = MaskWeights(proj=2.0, seg=0.3)
