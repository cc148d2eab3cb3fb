"""Training of the label network: people made on the fly, spoilt as predictors spoil them, and their truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import repeat
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch

from ...body.labels import label_set
from ...body.pose_prior import FREE_PARTS
from ...body.posing import pose
from ...body.rotations import rotation_to_axis_angle
from ...body.skeletons import MPJPE_HIPS, MPJPE_JOINTS
from ...body.template import JOINT_NAMES, NUM_PARTS
from ...cameras import Perspective
from ...errors import InputError
from ...metrics import confusion, foreground_counts, mpjpe, pa_mpjpe, part_f1, pooled
from ...networks.regression.checkpoint import load_label_network, save_label_network
from ...networks.regression.label_network import (
    NUM_CONDITIONS,
    LabelNetwork,
    LabelNetworkConfig,
    label_shares,
    label_table,
    network_conditions,
)
from ...networks.regression.landmark_attention import NUM_SAID
from ...networks.regression.landmarks import LANDMARKS
from ...networks.regression.predicted import Predicted, posed_landmarks
from ...networks.regression.regressor import MISFITS
from ...networks.regression.upright import leans, turn_inputs, turn_predicted
from ...render.ellipsoids import draw_ellipsoids
from ...render.renderers import RendererEllipsoids
from ...results.palette import group_colours
from ..synthetic.label_noise import TRAINING_LABEL_SETS
from ..synthetic.pose_sampler import PoseBank
from ..synthetic.poses import mean_sizes
from ..synthetic.training_people import PeopleBatch, PeopleMaker
from .config import TrainingConfig
from .task import PACKAGED_NETWORK, Task, weighted_losses

if TYPE_CHECKING:
    from PIL import Image

_VALIDATION_SEED = 7  # the same people in every run
_BATCH = 256  # of validation
_SHOWN = 12  # people on the contact sheet
_TILTED = np.radians(45.0)  # of the pelvis, from upright in the picture
_SHARE = 0.68  # of the truth, within what ``Uncertainty`` says
_ASTRAY = 2.0  # [half-sides of the crop]: projections farther off pull no harder, nor do they stop a run
_EXACT = 1e-3  # errors below [m or rad] are equal
_PARTS = "ellipbody20"
LSP_JOINTS = [JOINT_NAMES.index(name) for name in MPJPE_JOINTS]


@dataclass(frozen=True)
class LabelData:
    """Source of the people."""

    poses: str = ""  # folder of motion capture, or a pose bank made of one (.npz); "" takes the packaged prior alone
    validation: int = 1024  # number of held-out people that errors are measured on
    ahead: int = 1  # batches whose people are made at once, which takes less time and more memory
    uses: int = 1  # batches that each person is in

    def __post_init__(self) -> None:
        for name in ("validation", "ahead", "uses"):
            if getattr(self, name) < 1:
                raise InputError(f"data.{name}: {getattr(self, name)}; expected 1 or more")


class LabelTask(Task):
    """The ``Task`` of the label network."""

    MODEL: ClassVar[type[Any]] = LabelNetworkConfig
    DATA: ClassVar[type[Any]] = LabelData
    WEIGHTS: ClassVar[Mapping[str, float]] = MappingProxyType(
        {
            "joints": 20.0,
            "rotations": 1.0,
            "proj": 10.0,
            "seg": 4.0,
            "lengths": 0.5,
            "thicknesses": 0.5,
            "spreads": 0.1,
            "nearness": 0.5,
        }
    )

    def __init__(self, config: TrainingConfig, *, rank: int, processes: int, device: torch.device) -> None:
        super().__init__(config, rank=rank, processes=processes, device=device)
        # As the first layer takes them, so that nothing is converted.
        kind = torch.bfloat16 if config.precision == "bf16" and device.type == "cuda" else torch.float32
        tables = torch.stack([label_table(label_set(name)) for name in TRAINING_LABEL_SETS])
        padding = -tables.shape[2] % 8  # GPUs convolve such numbers of channels in half the time
        self._tables = torch.nn.functional.pad(tables, (0, padding)).to(device, kind)
        # Processes differ in their seeds; those of one process follow one another.
        maker, data = self._make_maker(config.seed * processes + rank, held_out=False), config.data
        self._stock = _Stock(maker, size=config.batch_size, ahead=data.ahead, uses=data.uses)

    def _make_maker(self, seed: int, *, held_out: bool) -> PeopleMaker:
        source = self.config.data.poses
        poses = PoseBank.read(source, held_out=held_out) if source else PoseBank.of_prior(seed=seed)
        return PeopleMaker(poses, size=self.config.model.size, device=self.device, seed=seed, held_out=held_out)

    def model(self) -> torch.nn.Module:
        """A new network."""
        return LabelNetwork(self.config.model).to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def batch(self, device: torch.device) -> PeopleBatch:
        """People of the stock."""
        return self._stock.take()

    def loss(self, model: torch.nn.Module, batch: PeopleBatch) -> dict[str, torch.Tensor]:
        """The weighted terms of ``body_losses``, and their sum."""
        terms = body_losses(self.predict(model, batch), batch)
        return weighted_losses(terms, self.config.weights, self.left_out)

    def validate(self, model: torch.nn.Module, device: torch.device) -> dict[str, float]:
        """Errors on held-out bodies in held-out poses, and how often the truth is where the network is sure of it."""
        joints, counts, within, tilted = [], [], [], []
        for people in self.held_out:
            predicted = self.predict(model, people)
            posed = predicted.posed().joints
            points = (posed[:, LSP_JOINTS], people.joints[:, LSP_JOINTS])
            joints.append(torch.stack([mpjpe(*points, centre_on=MPJPE_HIPS), pa_mpjpe(*points)]))
            counts.append(confusion(_drawn(predicted, people), people.parts, NUM_PARTS + 1).sum(0))
            within.append((torch.cat(errors_of(predicted, posed, people), 1) < spreads_of(predicted)).float())
            tilted.append(people.orientation[:, 1, 1] > -np.cos(_TILTED))  # y points down in the picture
        errors = torch.cat(joints, dim=1) * 1000
        matrix, shares, depths = pooled(counts), torch.cat(within).mean(0), len(JOINT_NAMES) - 1
        return {
            "MPJPE [mm]": float(errors[0].mean()),
            "PA-MPJPE [mm]": float(errors[1].mean()),
            "PA-MPJPE of the tilted [mm]": float(errors[1, torch.cat(tilted)].mean()),
            "part F1": float(part_f1(matrix)),
            "foreground F1": float(part_f1(foreground_counts(matrix))),
            "depths within their 68 %": float(shares[:depths].mean()),
            "rotations within their 68 %": float(shares[depths:].mean()),
        }

    def pictures(self, model: torch.nn.Module, device: torch.device) -> Image.Image | None:
        """Rows of what is seen, the truth, and the prediction."""
        from PIL import Image

        people = self.held_out[0]
        found = _drawn(self.predict(model, people), people)
        names = list(TRAINING_LABEL_SETS)
        seen = [names[index] for index in people.label_sets.tolist()]
        rows = []
        for images, sets in ((people.groups, seen), (people.parts, repeat(_PARTS)), (found, repeat(_PARTS))):
            shown = zip(images[:_SHOWN].cpu().numpy(), sets, strict=False)
            rows.append(np.concatenate([group_colours(label_set(of).part_groups)[ids] for ids, of in shown], axis=1))
        return Image.fromarray(np.concatenate(rows))

    def save(self, path: Path, weights: Mapping[str, torch.Tensor], about: Mapping[str, Any], *, bits: int) -> None:
        """Write the network."""
        save_label_network(path, weights, self.config.model, about, bits=bits)

    def read(self, source: str) -> Mapping[str, torch.Tensor]:
        """Weights of a trained network; see ``Task``."""
        network = load_label_network(None if source == PACKAGED_NETWORK else source)
        weights, sizes, expected = network.state_dict(), _sizes(network.config), _sizes(self.config.model)
        # What the network is given beside counts for nothing at first.
        if expected.attention_layers and not sizes.attention_layers:
            sizes = replace(sizes, attention_layers=expected.attention_layers, attention_width=expected.attention_width)
            weights |= {name: value for name, value in self.model().state_dict().items() if "attention" in name}
            before = network.regressor.features
            for name in ("regressor.first.linear.weight", "uncertainty.layers.0.weight"):
                known, others = weights[name][:, :before], weights[name][:, before:]
                weights[name] = torch.cat([torch.nn.functional.pad(known, (0, NUM_SAID)), others], dim=1)
        if expected.regressor.feedback and not sizes.regressor.feedback:
            sizes = replace(sizes, regressor=replace(sizes.regressor, feedback=True))
            first = "regressor.first.linear.weight"
            weights[first] = torch.nn.functional.pad(weights[first], (0, MISFITS))
        if expected.stature and not sizes.stature:
            sizes = replace(sizes, stature=True)
            # Conditions are the last columns of these layers.
            for name, before in (("keypoints.0.weight", 3 * len(LANDMARKS)), ("attention.told.weight", 3)):
                if name in weights:
                    more = before + NUM_CONDITIONS - weights[name].shape[1]
                    weights[name] = torch.nn.functional.pad(weights[name], (0, more))
        if sizes != expected:
            raise InputError(f"initial: {source}: a network of {network.config}; expected {self.config.model}")
        return weights

    def state_dict(self) -> dict[str, Any]:
        """State of what makes people."""
        return self._stock.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self._stock.load_state_dict(state)

    def predict(self, model: torch.nn.Module, people: PeopleBatch) -> Predicted:
        """Bodies that a network says people have."""
        angles = leans(people.keypoints)
        conditions = network_conditions(people.lenses, people.lens_certainty, people.statures)
        groups, keypoints, conditions = turn_inputs(
            people.groups[:, None].float(), people.keypoints, conditions, -angles
        )
        shares = label_shares(groups[:, 0].byte(), self._tables, people.label_sets)
        if not model.training:  # validated without autocast
            shares = shares.float()
        predicted: Predicted = model(shares, keypoints, conditions)
        return turn_predicted(predicted, angles)

    @cached_property
    def held_out(self) -> list[PeopleBatch]:
        """The people that errors are measured on."""
        maker = self._make_maker(_VALIDATION_SEED, held_out=True)
        count = self.config.data.validation
        return [maker(min(_BATCH, count - first)) for first in range(0, count, _BATCH)]


class _Stock:
    """People made for ``ahead`` batches of ``size`` at once, each of whom is in ``uses`` of them, with other people."""

    def __init__(self, maker: PeopleMaker, *, size: int, ahead: int, uses: int) -> None:
        self._maker, self._count = maker, size * ahead
        orders = [torch.randperm(self._count, generator=torch.Generator().manual_seed(use)) for use in range(uses)]
        self._batches = torch.cat(orders).to(maker.device).split(size)
        self._begin(maker.state_dict())

    def _begin(self, before: dict[str, Any]) -> None:
        self._before = before  # state of the maker
        self._taken = len(self._batches)  # batches of the people in stock
        self._people: PeopleBatch | None = None

    def take(self) -> PeopleBatch:
        """The next batch."""
        if self._people is None or self._taken == len(self._batches):
            self._before, self._taken = self._maker.state_dict(), 0
            self._people = self._maker(self._count)
        self._taken += 1
        return self._people.select(self._batches[self._taken - 1])

    def state_dict(self) -> dict[str, Any]:
        used_up = self._taken == len(self._batches)
        return {"maker": self._maker.state_dict() if used_up else self._before, "taken": self._taken}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self._maker.load_state_dict(state["maker"])
        self._begin(state["maker"])
        if state["taken"] < len(self._batches):
            self.take()
            self._taken = state["taken"]


def _sizes(config: LabelNetworkConfig) -> LabelNetworkConfig:
    """Configuration without dropout, which changes no weight's shape."""
    return replace(config, regressor=replace(config.regressor, dropout=0.0))


def body_losses(predicted: Predicted, people: PeopleBatch) -> dict[str, torch.Tensor]:
    """Loss terms by comparison with the truth of the same people, each a mean over the batch, without weights.

    L_3D, L_proj, L_seg through PartDR, L_l and L_t (paper, section 3.4), rotations, and what is said beside the body.
    Predicted bodies are seen from where the picture's camera was, whether the network knows it or not.

    * joints: mean absolute error of coordinates [m];
    * rotations: squared difference of a rotation matrix, mean over the parts;
    * proj: mean absolute error of projected landmarks [half-sides of the crop];
    * seg: L_seg as a share of the picture's pixels, with the "edges" gradient;
    * lengths: mean absolute logarithm of the ratio to the true ones;
    * thicknesses: mean squared logarithm of the ratio to the mean body's;
    * spreads: pinball loss (Koenker and Bassett, 1978) of the logarithms of errors, least where 68 % are below;
    * nearness: mean absolute error of 1 / distance [1/m].
    """
    size = people.parts.shape[-1]
    body, camera = _before_camera(predicted, people, size)
    projected = camera.project(posed_landmarks(pose(*body, validate=False), LANDMARKS))[..., :2] * (2 / size) - 1
    seg = RendererEllipsoids("edges").body_loss(body, camera, people.parts, validate=False)
    joints = predicted.posed().joints
    mean_thicknesses = mean_sizes(joints.device, joints.dtype)[1]
    return {
        "joints": (joints - people.joints).abs().mean(),
        "rotations": (_turns(predicted) - _turns(people)).square().sum((2, 3)).mean(),
        "proj": (projected - people.points).abs().clamp_max(_ASTRAY).mean(),
        "seg": seg.mean() / size**2,
        "lengths": (predicted.lengths / people.lengths).log().abs().mean(),
        "thicknesses": (predicted.thicknesses / mean_thicknesses).log().square().mean(),
        **uncertainty_losses(predicted, joints.detach(), people),
    }


def uncertainty_losses(predicted: Predicted, joints: torch.Tensor, people: PeopleBatch) -> dict[str, torch.Tensor]:
    """The terms "spreads" and "nearness" of ``body_losses``; ``joints`` as in ``errors_of``."""
    said = predicted.uncertainty
    assert said is not None
    errors = torch.cat(errors_of(predicted, joints, people), dim=1)
    apart = errors.clamp_min(_EXACT).log() - spreads_of(predicted).log()
    return {
        "spreads": torch.maximum(_SHARE * apart, (_SHARE - 1) * apart).mean(),
        "nearness": (said.nearness - 1 / people.distances).abs().mean(),
    }


def spreads_of(predicted: Predicted) -> torch.Tensor:
    """Spreads that the network states for ``errors_of``, joined, shape (B, 39)."""
    assert predicted.uncertainty is not None
    return torch.cat([predicted.uncertainty.depths, predicted.uncertainty.turns], dim=1)


@torch.no_grad()
def errors_of(predicted: Predicted, joints: torch.Tensor, people: PeopleBatch) -> tuple[torch.Tensor, torch.Tensor]:
    """Errors that ``Uncertainty`` speaks of: joints' along the view [m], (B, 20), and rotations' [rad], (B, 19).

    ``joints`` are those of the predicted bodies, the pelvis at the origin.
    """
    depths = (joints - people.joints)[:, 1:, 2].abs()
    turned = _free_turns(predicted).mT @ _free_turns(people)
    return depths, rotation_to_axis_angle(turned).norm(dim=-1)


def _turns(bodies: Predicted | PeopleBatch) -> torch.Tensor:
    """Orientation and local rotations, shape (B, 21, 3, 3)."""
    return torch.cat([bodies.orientation[:, None], bodies.rotations], 1)


def _free_turns(bodies: Predicted | PeopleBatch) -> torch.Tensor:
    """Orientation and the local rotations of ``FREE_PARTS``, which come last, shape (B, 19, 3, 3)."""
    return torch.cat([bodies.orientation[:, None], bodies.rotations[:, -len(FREE_PARTS) :]], 1)


def _before_camera(
    predicted: Predicted, people: PeopleBatch, size: int
) -> tuple[tuple[torch.Tensor, ...], Perspective]:
    """Arguments of ``pose`` for the predicted bodies before the pictures' cameras, and these cameras.

    The pelvis is at its true place, and the camera's lens is as long as the predicted scale says: with the true lens,
    a body said to be too large would come so near that its projection explodes.
    """
    weak = predicted.camera(size)
    ray = people.turns[..., 2] / people.turns[:, 2:, 2]
    focal = weak.scale * people.distances
    camera = Perspective(focal[:, None].expand(-1, 2), weak.translation - focal[:, None] * ray[:, :2])
    pelvises, orientation = ray * people.distances[:, None], people.turns @ predicted.orientation
    return (orientation, pelvises, predicted.rotations, predicted.lengths, predicted.thicknesses), camera


def _drawn(predicted: Predicted, people: PeopleBatch) -> torch.Tensor:
    """Part labels of the predicted bodies as the true cameras see them, shape (B, S, S), uint8."""
    size = people.parts.shape[-1]
    body, camera = _before_camera(predicted, people, size)
    return draw_ellipsoids(pose(*body, validate=False), camera, (size, size), validate=False).labels
