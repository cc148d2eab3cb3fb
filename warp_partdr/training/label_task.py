"""Training of the label network: people made on the fly, spoilt as predictors spoil them, and their truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch

from ..body.labels import label_set
from ..body.skeletons import MPJPE_HIPS, MPJPE_JOINTS
from ..body.template import JOINT_NAMES, NUM_PARTS, template
from ..errors import InputError
from ..metrics import confusion, foreground_counts, mpjpe, pa_mpjpe, part_f1, pooled
from ..network.checkpoint import load_label_network, save_label_network
from ..network.label_network import LabelNetwork, LabelNetworkConfig, label_shares, label_table
from ..network.landmarks import LANDMARKS
from ..network.predicted import Predicted, posed_landmarks
from ..render.renderers import RendererEllipsoids
from ..results.palette import group_colours
from ..synthetic.label_noise import TRAINING_LABEL_SETS
from ..synthetic.pose_sampler import PoseBank
from ..synthetic.training_people import PeopleBatch, PeopleMaker
from .config import TrainingConfig
from .task import PACKAGED_NETWORK, Task, weighted_losses

if TYPE_CHECKING:
    from PIL import Image

_VALIDATION_SEED = 7  # the same people in every run
_BATCH = 256  # of validation
_SHOWN = 12  # people on the contact sheet
_PARTS = "ellipbody20"
_LSP = [JOINT_NAMES.index(name) for name in MPJPE_JOINTS]


@dataclass(frozen=True)
class LabelData:
    """Source of the people."""

    poses: str = ""  # folder of motion capture, or a pose bank made of one (.npz); "" takes the packaged prior alone
    validation: int = 1024  # number of held-out people that errors are measured on


class LabelTask(Task):
    """The ``Task`` of the label network."""

    MODEL: ClassVar[type[Any]] = LabelNetworkConfig
    DATA: ClassVar[type[Any]] = LabelData
    WEIGHTS: ClassVar[Mapping[str, float]] = MappingProxyType(
        {"joints": 20.0, "rotations": 1.0, "proj": 10.0, "seg": 4.0, "lengths": 0.5, "thicknesses": 0.5}
    )

    def __init__(self, config: TrainingConfig, *, rank: int, processes: int, device: torch.device) -> None:
        super().__init__(config, rank=rank, processes=processes, device=device)
        # As the first layer takes them, so that nothing is converted.
        kind = torch.bfloat16 if config.precision == "bf16" and device.type == "cuda" else torch.float32
        self._tables = torch.stack([label_table(label_set(name)) for name in TRAINING_LABEL_SETS]).to(device, kind)
        # Processes differ in their seeds; those of one process follow one another.
        self._maker = self._make_maker(config.seed * processes + rank, held_out=False)

    def _make_maker(self, seed: int, *, held_out: bool) -> PeopleMaker:
        source = self.config.data.poses
        poses = PoseBank.read(source, held_out=held_out) if source else PoseBank.of_prior(seed=seed)
        return PeopleMaker(poses, size=self.config.model.size, device=self.device, seed=seed, held_out=held_out)

    def model(self) -> torch.nn.Module:
        """A new network."""
        return LabelNetwork(self.config.model).to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def batch(self, device: torch.device) -> PeopleBatch:
        """New people."""
        return self._maker(self.config.batch_size)

    def loss(self, model: torch.nn.Module, batch: PeopleBatch) -> dict[str, torch.Tensor]:
        """The weighted terms of ``body_losses``, and their sum."""
        terms = body_losses(self._predict(model, batch), batch)
        return weighted_losses(terms, self.config.weights, self.left_out)

    def validate(self, model: torch.nn.Module, device: torch.device) -> dict[str, float]:
        """Errors on held-out bodies in held-out poses."""
        joints, counts = [], []
        for people in self._held_out:
            predicted = self._predict(model, people)
            points = (predicted.posed().joints[:, _LSP], people.joints[:, _LSP])
            joints.append(torch.stack([mpjpe(*points, centre_on=MPJPE_HIPS), pa_mpjpe(*points)]))
            counts.append(confusion(predicted.drawn(people.parts.shape[-1]), people.parts, NUM_PARTS + 1).sum(0))
        errors = torch.cat(joints, dim=1).mean(1) * 1000
        matrix = pooled(counts)
        return {
            "MPJPE [mm]": float(errors[0]),
            "PA-MPJPE [mm]": float(errors[1]),
            "part F1": float(part_f1(matrix)),
            "foreground F1": float(part_f1(foreground_counts(matrix))),
        }

    def pictures(self, model: torch.nn.Module, device: torch.device) -> Image.Image | None:
        """Rows of what is seen, the truth, and the prediction."""
        from PIL import Image

        people = self._held_out[0]
        drawn = self._predict(model, people).drawn(people.parts.shape[-1])
        names = list(TRAINING_LABEL_SETS)
        seen = [names[index] for index in people.label_sets.tolist()]
        rows = []
        for images, sets in ((people.groups, seen), (people.parts, repeat(_PARTS)), (drawn, repeat(_PARTS))):
            shown = zip(images[:_SHOWN].cpu().numpy(), sets, strict=False)
            rows.append(np.concatenate([group_colours(label_set(of).part_groups)[ids] for ids, of in shown], axis=1))
        return Image.fromarray(np.concatenate(rows))

    def save(self, path: Path, weights: Mapping[str, torch.Tensor], about: Mapping[str, Any], *, half: bool) -> None:
        """Write the network."""
        save_label_network(path, weights, self.config.model, about, half=half)

    def read(self, source: str) -> Mapping[str, torch.Tensor]:
        """Weights of a trained network; see ``Task``."""
        network = load_label_network(None if source == PACKAGED_NETWORK else source)
        if network.config != self.config.model:
            raise InputError(f"initial: {source}: a network of {network.config}; expected {self.config.model}")
        return network.state_dict()

    def state_dict(self) -> dict[str, Any]:
        """Of what makes people."""
        return self._maker.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self._maker.load_state_dict(state)

    def _predict(self, model: torch.nn.Module, people: PeopleBatch) -> Predicted:
        shares = label_shares(people.groups, self._tables, people.label_sets)
        if not model.training:  # validated without autocast
            shares = shares.float()
        predicted: Predicted = model(shares, people.keypoints)
        return predicted

    @cached_property
    def _held_out(self) -> list[PeopleBatch]:
        maker = self._make_maker(_VALIDATION_SEED, held_out=True)
        count = self.config.data.validation
        return [maker(min(_BATCH, count - first)) for first in range(0, count, _BATCH)]


def body_losses(predicted: Predicted, people: PeopleBatch) -> dict[str, torch.Tensor]:
    """Loss terms by comparison with the truth of the same people, each a mean over the batch, without weights.

    L_3D, L_proj, L_seg through PartDR, L_l and L_t (paper, section 3.4), and rotations.

    * joints: mean absolute error of coordinates [m];
    * rotations: squared difference of a rotation matrix, mean over the parts;
    * proj: mean absolute error of projected landmarks [half-sides of the crop];
    * seg: L_seg as a share of the picture's pixels, with the "edges" gradient;
    * lengths: mean absolute logarithm of the ratio to the true ones;
    * thicknesses: mean squared logarithm of the ratio to the mean body's.
    """
    posed = predicted.posed()
    size = people.parts.shape[-1]
    turns, true_turns = (torch.cat([each.orientation[:, None], each.rotations], 1) for each in (predicted, people))
    seen = predicted.camera(2).project(posed_landmarks(posed, LANDMARKS))[..., :2] - 1
    seg = RendererEllipsoids("edges").crop_loss(predicted, people.parts)
    mean_thicknesses = torch.as_tensor(template().mean_thicknesses).to(predicted.thicknesses)
    return {
        "joints": (posed.joints - people.joints).abs().mean(),
        "rotations": (turns - true_turns).square().sum((2, 3)).mean(),
        "proj": (seen - people.points).abs().mean(),
        "seg": seg.mean() / size**2,
        "lengths": (predicted.lengths / people.lengths).log().abs().mean(),
        "thicknesses": (predicted.thicknesses / mean_thicknesses).log().square().mean(),
    }
