"""Keypoints as detectors give them, in batches on a device: they jitter, stray, change sides and go missing."""

from __future__ import annotations

import numpy as np
import torch

from ...body.landmarks import mirror_order
from ...body.skeletons import skeleton
from ...networks.regression.landmarks import LANDMARKS, network_keypoints
from .noise import HIDDEN_CONFIDENCE, HIDDEN_NOISE, KEYPOINT_NOISE, SWAPPED_KEYPOINTS
from .rng import TorchRng

# At strength 1.
_DROPOUT = 0.06  # of a keypoint; twice that for hidden ones
_SWAP = 0.05  # of a limb's sides; all sides at once in a fifth of that
_STRAY = 0.008  # of a keypoint, to be anywhere

# Shares of samples by the landmarks that their detector gives; of the packaged one, ``DetectorErrors`` knows more.
_DETECTORS: dict[str, float] = {
    "coco17": 0.4,
    "every": 0.1,
    "no face": 0.1,
    "body25": 0.1,
    "lsp14": 0.1,
    "mpii16": 0.06,
    "h36m17": 0.06,
}
_FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")


class KeypointNoise:
    """The noise model of keypoints, of one source of chance."""

    def __init__(self, rng: TorchRng) -> None:
        self.rng = rng
        device = rng.device
        self._detectors = torch.stack([_seen_by(name) for name in _DETECTORS]).to(device)
        self._detector_weights = torch.tensor(list(_DETECTORS.values()), device=device)
        self._mirror = torch.from_numpy(mirror_order(LANDMARKS)).to(device)
        self._swaps = torch.from_numpy(np.stack([mirror_order(LANDMARKS, joints) for joints in SWAPPED_KEYPOINTS])).to(
            device
        )
        self._confidence_odds = torch.tensor([0.4, 0.15, 0.1, 0.35], device=device)

    def detected(self, count: int) -> torch.Tensor:
        """Landmarks that each sample's detector knows, shape (B, 24), bool."""
        return self._detectors[self.rng.choice(self._detector_weights, count)]

    def keypoints(
        self,
        points: torch.Tensor,  # (B, 24, 2), true places in the crop
        hidden: torch.Tensor,  # (B, 24), those behind something
        known: torch.Tensor,  # (B, 24), those that the detector can give at all
        stature: torch.Tensor,  # (B,), in crop coordinates
        strength: torch.Tensor,  # (B,)
    ) -> torch.Tensor:
        """Keypoints as detectors give them, shape (B, 24, 3): crop coordinates and confidence, all 0 where missing."""
        rng, (count, landmarks) = self.rng, hidden.shape
        strength = strength[:, None]
        spread = strength * KEYPOINT_NOISE * stature[:, None] * torch.where(hidden, HIDDEN_NOISE, 1.0)
        offsets = spread[..., None] * rng.normal(count, landmarks, 2)
        stray = rng.chance(strength * _STRAY, count, landmarks)
        anywhere = rng.uniform(count, landmarks, 2, low=-1.0, high=1.0)
        seen = torch.where(stray[..., None], anywhere, points + offsets)

        order = torch.arange(landmarks, device=rng.device).expand(count, -1)
        for swap in self._swaps:
            swapped = rng.chance(strength * _SWAP / len(self._swaps), count, 1)
            order = torch.where(swapped, order[:, swap], order)
        order = torch.where(rng.chance(strength * _SWAP / 5, count, 1), order[:, self._mirror], order)
        seen, hidden = seen.gather(1, order[..., None].expand(-1, -1, 2)), hidden.gather(1, order)
        known = known & known.gather(1, order)

        known = known & ~rng.chance(strength * _DROPOUT * torch.where(hidden, 2.0, 1.0), count, landmarks)
        confidence = self._confidence(hidden, stray, offsets.norm(dim=-1) / stature[:, None])
        return torch.cat([seen, confidence[..., None]], dim=-1) * known[..., None]

    def _confidence(self, hidden: torch.Tensor, stray: torch.Tensor, error: torch.Tensor) -> torch.Tensor:
        """Confidence of the keypoints, shape (B, 24).

        The confidence of some detectors says what is hidden or wrong. That of others says nothing.
        """
        rng, shape = self.rng, tuple(hidden.shape)
        random = rng.uniform(*shape)
        doubt = 0.6 * hidden + 15.0 * error + 0.5 * stray
        kinds = torch.stack(
            [
                torch.where(hidden, HIDDEN_CONFIDENCE, 1.0),
                torch.ones_like(random),
                0.15 + 0.85 * random,
                (1.0 - doubt * random.sqrt() - 0.2 * rng.uniform(*shape)).clamp(0.05, 1.0),
            ],
            dim=1,
        )
        kind = rng.choice(self._confidence_odds, shape[0])
        return kinds[torch.arange(shape[0], device=rng.device), kind]


def _seen_by(detector: str) -> torch.Tensor:
    everything = {"every": LANDMARKS, "no face": tuple(name for name in LANDMARKS if name not in _FACE)}
    names = everything[detector] if detector in everything else skeleton(detector).landmarks
    return network_keypoints(names, torch.zeros(len(names), 2), torch.ones(len(names)))[:, 2] > 0
