"""The noise of ``anny_people.py``: PartBench's, at its usual strength."""

from warp_partdr.synthetic.bench_noise import noisy_keypoints, noisy_labels

__all__ = ["noisy_keypoints", "noisy_labels"]
