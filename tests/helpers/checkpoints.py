"""Tiny checkpoints of ``transformers``, as a user's folder holds them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from warp_partdr.body.labels import LABEL_SETS

COLOURS = {"image_mean": [0.485, 0.456, 0.406], "image_std": [0.229, 0.224, 0.225]}


def class_names(label_set: str) -> dict[int, str]:
    """Names of a label set's classes, as a checkpoint's ``id2label`` has them."""
    labels = LABEL_SETS[label_set]
    return {source: labels.class_names.get(source, labels.ids[source]) for source in labels.channel_ids}


def save(model: Any, folder: Path, size_px: tuple[int, int], **settings: Any) -> Path:
    model.save_pretrained(folder)
    sides = settings.pop("size", {"height": size_px[0], "width": size_px[1]})
    (folder / "preprocessor_config.json").write_text(json.dumps({"size": sides, **COLOURS, **settings}))
    return folder


def tiny_segformer(folder: Path, classes: Mapping[int, str], size: tuple[int, int] = (64, 64)) -> Path:
    """SegFormer with random weights."""
    from transformers import SegformerConfig, SegformerForSemanticSegmentation

    torch.manual_seed(0)
    ones, eights = [1] * 4, [8] * 4
    config = SegformerConfig(
        hidden_sizes=eights, depths=ones, num_attention_heads=ones, decoder_hidden_size=8, id2label=dict(classes),
        initializer_range=0.5,  # large, so that what it says depends on the picture
    )  # fmt: skip
    return save(SegformerForSemanticSegmentation(config), folder, size)


def tiny_sapiens2(folder: Path, classes: Mapping[int, str]) -> Path:
    """Sapiens2 with random weights, for pictures of 64 x 48."""
    from transformers import Sapiens2Config, Sapiens2ForSemanticSegmentation, Sapiens2HeadConfig

    torch.manual_seed(0)
    head = Sapiens2HeadConfig(upsample_out_channels=[8], conv_out_channels=[8]).to_dict()
    sizes: Any = {"hidden_size": 16, "intermediate_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2}
    config = Sapiens2Config(
        **sizes, image_size=[64, 48], num_key_value_attention_heads=1, head_config=head, id2label=dict(classes)
    )
    return save(Sapiens2ForSemanticSegmentation(config), folder, (64, 48))


def knowing_vitpose(folder: Path, cells: Sequence[tuple[int, int]], *, experts: int = 1) -> Path:
    """ViTPose for pictures of 256 x 192 that sees each keypoint in a given cell (row, column) of 16 x 12, always."""
    from transformers import VitPoseBackboneConfig, VitPoseConfig, VitPoseForPoseEstimation

    count = 16 * 12
    backbone = VitPoseBackboneConfig(
        image_size=[256, 192], hidden_size=count, num_hidden_layers=1, num_attention_heads=1, mlp_ratio=1,
        out_indices=[1], num_experts=experts, part_features=count // 2,
    )  # fmt: skip
    model = VitPoseForPoseEstimation(VitPoseConfig(backbone_config=backbone, num_labels=len(cells)))
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if "layernorm.weight" not in name:
                parameter.zero_()
        model.backbone.embeddings.position_embeddings[0, 1:] = torch.eye(count)
        for keypoint, (row, column) in enumerate(cells):
            model.head.conv.weight[keypoint, 12 * row + column, 1, 1] = 1 / count**0.5
    return save(model, folder, (256, 192))


def tiny_detector(kind: str, folder: Path, classes: Mapping[int, str]) -> Path:
    """Detector of ``transformers`` with random weights: rt_detr, rt_detr_v2, detr, conditional_detr or yolos."""
    import transformers

    torch.manual_seed(0)
    sides: dict[str, Any] = {"height": 64, "width": 64}
    small: dict[str, Any] = {"id2label": dict(classes), "num_queries": 5, "d_model": 16, "decoder_layers": 2}
    heads: dict[str, Any] = {"encoder_attention_heads": 2, "decoder_attention_heads": 2, "encoder_ffn_dim": 16}
    heads |= {"decoder_ffn_dim": 16, "encoder_layers": 1}
    if kind.startswith("rt_detr"):
        name = "RTDetrV2" if kind == "rt_detr_v2" else "RTDetr"
        backbone = transformers.RTDetrResNetConfig(
            embedding_size=8, hidden_sizes=[8, 8, 8, 8], depths=[1, 1, 1, 1], layer_type="basic",
            out_features=["stage2", "stage3", "stage4"],
        )  # fmt: skip
        config = getattr(transformers, f"{name}Config")(
            backbone_config=backbone, encoder_in_channels=[8, 8, 8], feat_strides=[8, 16, 32], encoder_hidden_dim=16,
            decoder_in_channels=[16, 16, 16], decoder_n_points=2, **small, **heads,
        )  # fmt: skip
        model = getattr(transformers, f"{name}ForObjectDetection")(config)
    elif kind == "yolos":
        config = transformers.YolosConfig(
            hidden_size=16, num_hidden_layers=1, num_attention_heads=2, intermediate_size=16, image_size=[64, 64],
            num_detection_tokens=5, id2label=dict(classes),
        )  # fmt: skip
        model = transformers.YolosForObjectDetection(config)
    else:
        name = {"detr": "Detr", "conditional_detr": "ConditionalDetr"}[kind]
        backbone = transformers.ResNetConfig(
            embedding_size=8,
            hidden_sizes=[8, 8, 8, 8],
            depths=[1, 1, 1, 1],
            layer_type="basic",
            out_features=["stage4"],
        )
        config = getattr(transformers, f"{name}Config")(
            backbone_config=backbone, use_timm_backbone=False, use_pretrained_backbone=False, backbone=None,
            **small, **heads,
        )  # fmt: skip
        model = getattr(transformers, f"{name}ForObjectDetection")(config)
    if not kind.startswith("rt_detr"):
        sides = {"shortest_edge": 48, "longest_edge": 64}
    return save(model, folder, (64, 64), size=sides)
