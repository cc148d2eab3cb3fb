"""The detailed body that clothes the demo's ellipsoids."""

from __future__ import annotations

import torch

from ..body.parameters import BodyParameters
from ..body.posing import Posed
from ..clothing.anny import anny
from ..clothing.model import DetailedModel
from ..clothing.registration import Registered, RegistrationOptions, register


class Clothing:
    """Registers Anny, once as a mean adult and then as edits of that one, which may grow beyond natural people.

    Args:
        options: Of the registrations; the defaults if None.
    """

    def __init__(self, options: RegistrationOptions | None = None) -> None:
        self._options = options
        self._mean: Registered | None = None

    @property
    def model(self) -> DetailedModel:
        """What bodies are clothed in."""
        return anny()

    def vertices(self, posed: Posed) -> torch.Tensor:
        """Those of the detailed body that clothes B = 1 posed body, in its frame [m], shape (V, 3); takes seconds."""
        if self._mean is None:
            self._mean = register(BodyParameters.mean(1).posed(), self.model, options=self._options)
        return register(posed, self.model, start=self._mean, options=self._options).detailed.vertices[0]
