"""Training of EllipBodyNet from pictures, as the paper does it (its "Implementation Details")."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch

from ...body.labels import IGNORE
from ...body.skeletons import MPJPE_HIPS, MPJPE_JOINTS
from ...errors import InputError
from ...inputs.observation import REFERENCE_SIZE
from ...metrics import confusion, mpjpe, pa_mpjpe, part_f1, pooled
from ...networks.regression.checkpoint import load_ellipbodynet, save_ellipbodynet
from ...networks.regression.ellipbodynet import EllipBodyNet, EllipBodyNetConfig, PicturePrediction
from ...networks.regression.predicted import posed_landmarks
from ...render.options import Gradient
from ...results.palette import PART_COLOURS
from .augment import Augmentation
from .config import Phase, TrainingConfig
from .picture_data import ExampleDataset, Examples, Feed, Source, make_example
from .picture_losses import body_terms, head_terms, label_sets, seg_term
from .task import PACKAGED_NETWORK, Task, weighted_losses

if TYPE_CHECKING:
    from PIL import Image

_BATCH = 64  # of validation
_SHOWN = 8  # people on the contact sheet


@dataclass(frozen=True)
class PictureData:
    """Data to learn from, and its changes."""

    sources: tuple[Source, ...] = ()
    augmentation: Augmentation = field(default_factory=Augmentation)
    workers: int = 8  # processes that read pictures; 0 reads in the training's own
    render_size: int = REFERENCE_SIZE  # [px], side of the crops that L_seg is drawn at
    gradient: Gradient = "partdr"  # of L_seg: the paper's, or "edges" or "coverage"


class PictureTask(Task):
    """The ``Task`` of EllipBodyNet."""

    MODEL: ClassVar[type[Any]] = EllipBodyNetConfig
    DATA: ClassVar[type[Any]] = PictureData
    WEIGHTS: ClassVar[Mapping[str, float]] = MappingProxyType(
        {"joints": 1.0, "proj": 1.0, "seg": 1e-2, "lengths": 1e-3, "thicknesses": 1e-3}  # the paper's
        | {"heatmaps": 100.0, "parts": 200.0}
    )

    def __init__(self, config: TrainingConfig, *, rank: int, processes: int, device: torch.device) -> None:
        super().__init__(config, rank=rank, processes=processes, device=device)
        sources = [source for source in config.data.sources if not source.validation]
        # Each with the phase from which on it is used.
        self._samples = [(source.first_phase, sample) for source in sources for sample in source.read(device)]
        if not any(first == 0 for first, _ in self._samples):
            raise InputError("data.sources: none to begin with; expected one at least, with first_phase 0")
        self.epoch = len(self._samples)
        self._saved_config: EllipBodyNetConfig = config.model
        self._feed: Feed | None = None
        self._consumed = 0
        self._skipped: dict[str, None] = {}

    def model(self) -> torch.nn.Module:
        """A new network."""
        network = EllipBodyNet(self.config.model)
        self._saved_config = network.config
        return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def begin(self, phase: Phase) -> None:
        """Leave out some terms from now on, and take in what data sets the phase adds."""
        super().begin(phase)
        index, data = self.config.phases.index(phase), self.config.data
        active = [sample for first, sample in self._samples if first <= index]
        self._feed = Feed(
            ExampleDataset(active, self.config.model.size, data.augmentation, self.config.seed),
            self.config.batch_size,
            workers=data.workers,
            rank=self.rank,
            processes=self.processes,
            consumed=self._consumed,
        )

    def batch(self, device: torch.device) -> Examples:
        """The next people."""
        assert self._feed is not None  # the loop begins a phase first
        examples = next(self._feed)
        self._consumed = self._feed.consumed
        self._skipped.update(self._feed.skipped)
        return examples.to(device)

    def loss(self, model: torch.nn.Module, batch: Examples) -> dict[str, torch.Tensor]:
        """The weighted terms and their sum."""
        prediction: PicturePrediction = model(batch.pictures)
        terms = {**body_terms(prediction, batch), **head_terms(prediction, batch)}
        if "seg" not in self.left_out:
            data = self.config.data
            terms["seg"] = seg_term(prediction, batch, size=data.render_size, gradient=data.gradient)
        return weighted_losses(terms, self.config.weights, self.left_out)

    def validate(self, model: torch.nn.Module, device: torch.device) -> dict[str, float]:
        """Errors on the sources that are for validation; none without such."""
        joints, distances = [], []
        counts: dict[tuple[str, tuple[int, ...]], list[np.ndarray]] = defaultdict(list)  # by score and label set
        for host in self._held_out:
            examples = host.to(device)
            prediction = model(examples.pictures)
            whole = examples.has_joints[:, MPJPE_HIPS].all(1)
            if whole.any():
                bodies = posed_landmarks(prediction.bodies.posed(), MPJPE_JOINTS)[whole]
                points, valid = (bodies, examples.joints[whole]), examples.has_joints[whole] > 0
                both = mpjpe(*points, centre_on=MPJPE_HIPS, valid=valid), pa_mpjpe(*points, valid=valid)
                joints.append(torch.stack(both))
            apart = (prediction.keypoints - examples.keypoints)[..., :2].norm(dim=-1) * (REFERENCE_SIZE / 2)
            distances.append(apart[examples.keypoints[..., 2] > 0])
            size = examples.groups.shape[-1]
            shown = {"part F1": prediction.bodies.drawn(size), "segmentation F1": prediction.part_labels(size)}
            for part_groups, chosen in label_sets(examples):
                table = torch.tensor([0, *part_groups], dtype=torch.uint8, device=device)
                classes = 1 + max(group for group in part_groups if group != IGNORE)
                for name, labels in shown.items():
                    found = confusion(table[labels[chosen].long()], examples.groups[chosen], classes)
                    counts[name, part_groups].append(found.sum(0))
        errors: dict[str, float] = {}
        if joints:
            means = torch.cat(joints, dim=1).mean(1) * 1000
            errors |= {"MPJPE [mm]": float(means[0]), "PA-MPJPE [mm]": float(means[1])}
        if distances:
            errors["keypoints [px of 256]"] = float(torch.cat(distances).mean())
        for name in dict.fromkeys(name for name, _ in counts):
            errors[name] = float(np.mean([part_f1(pooled(found)) for key, found in counts.items() if key[0] == name]))
        return errors

    def pictures(self, model: torch.nn.Module, device: torch.device) -> Image.Image | None:
        """Rows of pictures, the bodies over them, and the segmentation."""
        from PIL import Image

        if not self._held_out:
            return None
        shown = self._held_out[0].pictures[:_SHOWN].to(device)
        prediction = model(shown)
        size = shown.shape[-1]
        photos = shown.permute(0, 2, 3, 1).cpu().numpy()
        drawn = prediction.bodies.drawn(size).cpu().numpy()
        over = np.where(drawn[..., None] > 0, PART_COLOURS[drawn] // 4 * 3 + photos // 4, photos)
        rows = (photos, over, PART_COLOURS[prediction.part_labels(size).cpu().numpy()])
        return Image.fromarray(np.concatenate([np.concatenate(list(row), axis=1) for row in rows]))

    def save(self, path: Path, weights: Mapping[str, torch.Tensor], about: Mapping[str, Any], *, bits: int) -> None:
        """Write the network."""
        save_ellipbodynet(path, weights, self._saved_config, about, bits=bits)

    def read(self, source: str) -> Mapping[str, torch.Tensor]:
        """Weights of a trained network; see ``Task``."""
        if source == PACKAGED_NETWORK:
            raise InputError("initial: packaged; expected a file: the package has no EllipBodyNet")
        network = load_ellipbodynet(source)
        if replace(network.config, backbone="") != replace(self._saved_config, backbone=""):  # a name or a place
            raise InputError(f"initial: {source}: a network of {network.config}; expected {self._saved_config}")
        return network.state_dict()

    def skipped(self) -> Sequence[str]:
        """People from whom nothing could be learnt, and why."""
        return list(self._skipped)

    def state_dict(self) -> dict[str, Any]:
        """Number of people that it has had."""
        return {"consumed": self._consumed}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self._consumed = state["consumed"]

    @cached_property
    def _held_out(self) -> list[Examples]:
        found: list[Examples] = []
        for source in self.config.data.sources:
            for sample in source.read(self.device) if source.validation else ():
                try:
                    found.append(make_example(sample, self.config.model.size))
                except InputError as error:
                    self._skipped[f"{sample.source} {sample.name}: {error}"] = None
        return [Examples.cat(found[first : first + _BATCH]) for first in range(0, len(found), _BATCH)]
