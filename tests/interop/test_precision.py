"""Devices that multiply bfloat16 quickly, by what torch says of them."""

from __future__ import annotations

import pytest
import torch

from warp_partdr.interop.precision import multiplies_bfloat16


@pytest.mark.parametrize(
    ("avx", "amx", "quick"), [(False, False, False), (True, False, True), (False, True, True), (None, None, False)]
)
def test_a_cpu_multiplies_bfloat16_if_it_has_instructions_for_it(
    avx: bool | None, amx: bool | None, quick: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, has in (("_is_avx512_bf16_supported", avx), ("_is_amx_tile_supported", amx)):
        monkeypatch.delattr(torch.cpu, name, raising=False)  # None: torch doesn't tell
        if has is not None:
            monkeypatch.setattr(torch.cpu, name, lambda has=has: has, raising=False)
    assert multiplies_bfloat16("cpu") is quick


@pytest.mark.parametrize(
    ("cuda", "capability", "quick"), [("13.0", (7, 5), False), ("13.0", (8, 0), True), (None, (9, 0), False)]
)
def test_a_gpu_multiplies_bfloat16_from_ampere_on(
    cuda: str | None, capability: tuple[int, int], quick: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr(torch.version, "cuda", cuda)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: asked.append(device) or capability)
    assert multiplies_bfloat16("cuda:1") is quick
    assert asked == (["cuda:1"] if cuda else [])
