"""Torch's gradient mode within fits, which need gradients whatever the caller does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def with_gradients() -> Iterator[None]:
    """Let torch make gradients within, also for a caller in ``torch.no_grad`` or ``torch.inference_mode``; a decorator.

    Tensors that are made within are ordinary ones, from which a later stage can go on.
    """
    with torch.inference_mode(False), torch.enable_grad():
        yield
