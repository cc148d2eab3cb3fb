"""Networks from checkpoints of ``transformers``: parts by segmentation, keypoints by ViTPose, boxes of people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from ...body.labels import LABEL_SETS, LabelSet, label_set, label_sets_of
from ...body.skeletons import Skeleton
from ...errors import InputError, cause, install_command, shown
from ...inputs.keypoint_files import format_of, given_format
from ..detection.given_boxes import BoxNetwork
from .files import PictureInput, Say, describe, find_checkpoint, read_input
from .heat_maps import find_peaks
from .networks import KeypointNetwork, PartNetwork

# Of square networks: human parsing's upright pictures are made square by the image processor, 2 : 3 ones for example.
_STRETCH = 1.5
_PERSON = "person"
_COCO = 0  # of the data sets that ViTPose+ has experts for


def load_part_network(
    name: str,
    labels: str | Path | LabelSet | None = None,
    *,
    device: torch.device | str = "cpu",
    say: Say | None = None,
) -> PartNetwork:
    """Load a network that ``transformers.AutoModelForSemanticSegmentation`` knows, such as SegFormer or Sapiens2.

    Args:
        name: A folder, a name of the Hub that is in the local cache, or ``hf:`` and a name, which may be downloaded.
        labels: Label set of its classes. If it is None, it is the known set with the same names.
        device: Device to run on.
        say: Function that is told what is downloaded and loaded.

    Raises:
        InputError: If there is no such checkpoint, it has another task, or its classes are of no known label set.

    Examples:
        With a checkpoint of SegFormer in the folder ``segformer``, and the extra ``photo``:

        >>> from warp_partdr import load_part_network
        >>> network = load_part_network("segformer")
        >>> network.labels.name, network.size
        ('atr18', (64, 64))
    """
    with _transformers(name) as library:
        folder = find_checkpoint(name, say or _silent)
        config = _configuration(library, name, folder)
        if type(config) not in library.MODEL_FOR_SEMANTIC_SEGMENTATION_MAPPING:
            raise InputError(
                f"{name}: a {config.model_type}; expected a network of semantic segmentation, as segformer"
            )
        chosen = _label_set(name, dict(config.id2label), labels)
        picture_input = read_input(folder, name)
        model = _load(library.AutoModelForSemanticSegmentation, name, folder, device)

    def predict(pictures: torch.Tensor) -> torch.Tensor:
        return model(pixel_values=_prepared(pictures, picture_input)).logits.softmax(1)

    about = f"{_about(name, model, folder)}, labels {chosen.name}"
    (say or _silent)(f"parts from {about}")
    height, width = picture_input.size
    return PartNetwork(chosen, picture_input.size, predict, _STRETCH if height == width else 1.0, about, name)


def load_keypoint_network(
    name: str,
    skeleton: str | Path | Skeleton | None = None,
    *,
    device: torch.device | str = "cpu",
    say: Say | None = None,
) -> KeypointNetwork:
    """Load a ViTPose or ViTPose+ network for keypoints.

    Args:
        name: Name or folder as in ``load_part_network``. "NAME+NAME" names a ``load_box_network``, too, behind the plus
            sign.
        skeleton: Keypoint format of its points. If it is None, their number tells it.
        device: Device to run on.
        say: Function that is told what is downloaded and loaded.

    Raises:
        InputError: If there is no such checkpoint, it has another task, or its keypoints are of no known format.

    Examples:
        With a checkpoint of ViTPose in the folder ``vitpose``, and the extra ``photo``:

        >>> from warp_partdr import load_keypoint_network
        >>> network = load_keypoint_network("vitpose")
        >>> network.skeleton.name, network.size
        ('coco17', (256, 192))
    """
    name, other = split_names(name)
    boxes = None if other is None else load_box_network(other, device=device, say=say)
    with _transformers(name) as library:
        folder = find_checkpoint(name, say or _silent)
        config = _configuration(library, name, folder)
        if config.model_type != "vitpose":
            raise InputError(f"{name}: a {config.model_type}; expected a vitpose, whose keypoints are read")
        form = format_of(config.num_labels, None if skeleton is None else given_format(skeleton), name)
        height, width = config.backbone_config.image_size
        picture_input = read_input(folder, name)._replace(size=(height, width))
        model = _load(library.VitPoseForPoseEstimation, name, folder, device)
    experts = config.backbone_config.num_experts > 1

    def predict(pictures: torch.Tensor) -> torch.Tensor:
        chosen = torch.full((len(pictures),), _COCO, device=pictures.device) if experts else None
        heat = model(pixel_values=_prepared(pictures, picture_input), dataset_index=chosen).heatmaps
        peaks = find_peaks(heat)
        cells = peaks.new_tensor([heat.shape[-1], heat.shape[-2]])
        pixels = peaks.new_tensor([width, height])
        # It learned that the centres of the first and the last cells and pixels coincide (Huang et al. 2020, UDP).
        positions = (peaks[..., :2] * (pixels - 1) / (cells - 1) + 0.5) / pixels
        return torch.cat([positions, peaks[..., 2:].clamp(0, 1)], dim=-1)

    about = f"{_about(name, model, folder)}, keypoints {form.name}"
    (say or _silent)(f"keypoints from {about}")
    return KeypointNetwork(form, picture_input.size, predict, about, name, boxes)


def load_box_network(name: str, *, device: torch.device | str = "cpu", say: Say | None = None) -> BoxNetwork:
    """Load a network with a class "person" that ``transformers.AutoModelForObjectDetection`` knows, such as RT-DETR.

    Args:
        name: Name or folder as in ``load_part_network``.
        device: Device to run on.
        say: Function that is told what is downloaded and loaded.

    Raises:
        InputError: If there is no such checkpoint, it has another task, or no class "person".
    """
    with _transformers(name) as library:
        folder = find_checkpoint(name, say or _silent)
        config = _configuration(library, name, folder)
        if type(config) not in library.MODEL_FOR_OBJECT_DETECTION_MAPPING:
            raise InputError(f"{name}: a {config.model_type}; expected a network of object detection, as rt_detr")
        classes = {int(index): str(each) for index, each in config.id2label.items()}
        people = [index for index, each in classes.items() if each.strip().lower() == _PERSON]
        if len(people) != 1:
            names = ", ".join(list(classes.values())[:4])
            raise InputError(f"{name}: {len(people)} of its classes {shown(names)}, ... are {_PERSON!r}; expected one")
        picture_input = read_input(folder, name)
        model = _load(library.AutoModelForObjectDetection, name, folder, device)

    def predict(picture: torch.Tensor) -> torch.Tensor:
        said = model(pixel_values=_prepared(picture, picture_input))
        logits, boxes = said.logits[0].float(), said.pred_boxes[0].float()
        # One more than there are classes: the last one is "nothing", and they exclude each other.
        confidence = logits.softmax(1) if logits.shape[1] == len(classes) + 1 else logits.sigmoid()
        middle, half = boxes[:, :2], boxes[:, 2:] / 2
        return torch.cat([middle - half, middle + half, confidence[:, people]], dim=1)

    about = _about(name, model, folder)
    (say or _silent)(f"boxes from {about}")
    return BoxNetwork(picture_input.size, predict, picture_input.longest, about, name)


def split_names(name: str) -> tuple[str, str | None]:
    """Names of the keypoints' network and, of "NAME+NAME", of the boxes'; a folder may have a + in its own.

    Raises:
        InputError: If one of them is missing.
    """
    if "+" not in name or Path(name).expanduser().is_dir():
        return name, None
    keypoints, boxes = name.rsplit("+", 1)
    if not (keypoints and boxes):
        raise InputError(f"{name}: a + without two names; expected KEYPOINTS+BOXES")
    return keypoints, boxes


def _silent(text: str) -> None:
    """Tell nobody."""


@contextmanager
def _transformers(name: str) -> Iterator[Any]:
    """The library, without its progress bars and notes within."""
    try:
        import transformers
    except ImportError as error:
        raise InputError(f"{name}: needs transformers ({install_command('photo')})") from error
    logs = transformers.logging
    level, shows_bars = logs.get_verbosity(), logs.is_progress_bar_enabled()
    logs.set_verbosity_error()
    logs.disable_progress_bar()
    try:
        yield transformers
    finally:
        logs.set_verbosity(level)
        if shows_bars:
            logs.enable_progress_bar()


def _configuration(library: Any, name: str, folder: Path) -> Any:
    try:
        return library.AutoConfig.from_pretrained(str(folder), local_files_only=True, trust_remote_code=False)
    except Exception as error:  # of many kinds: each model checks its own values
        raise InputError(f"{name}: config.json: {cause(error)}") from error


def _load(kind: Any, name: str, folder: Path, device: torch.device | str) -> Any:
    """The model, in evaluation; all of its weights must be in the checkpoint."""
    try:
        model, found = kind.from_pretrained(
            str(folder),
            local_files_only=True,
            use_safetensors=True,
            trust_remote_code=False,
            dtype=torch.float32,
            output_loading_info=True,
        )
    except Exception as error:  # as above, and of the files
        raise InputError(f"{name}: {cause(error)}; expected a checkpoint for {kind.__name__}") from error
    if missing := sorted(found["missing_keys"]):
        raise InputError(f"{name}: no weights of {missing[0]}; expected a checkpoint trained for {kind.__name__}")
    return model.eval().to(device)


def _prepared(pictures: torch.Tensor, picture_input: PictureInput) -> torch.Tensor:
    mean, deviation = (
        pictures.new_tensor(values)[:, None, None] for values in (picture_input.mean, picture_input.deviation)
    )
    return (pictures - mean) / deviation


def _about(name: str, model: Any, folder: Path) -> str:
    return describe(name, type(model).__name__, model.num_parameters(), folder)


def _label_set(name: str, classes: Mapping[int, str], labels: str | Path | LabelSet | None) -> LabelSet:
    """Label set of a network's classes: the given one, or the one with their names."""
    if labels is not None:
        chosen = label_set(labels)
        if len(chosen.channel_ids) != len(classes):
            count = len(chosen.channel_ids)
            raise InputError(f"--labels: {chosen.name}, of {count} classes; expected one of {len(classes)}, for {name}")
        return chosen
    known = label_sets_of(classes)
    if len(known) != 1:
        what = "of several label sets" if known else "of no known label set"
        names = ", ".join(str(each) for each in list(classes.values())[:4])
        raise InputError(
            f"{name}: {len(classes)} classes, {shown(names)}, ..., {what}; expected --labels: one of "
            f"{', '.join(LABEL_SETS)}, or a JSON file"
        )
    return known[0]
