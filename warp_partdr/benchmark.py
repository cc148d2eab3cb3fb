"""Fits on people of known truth: data sets, methods side by side, and their scores.

``evaluate`` fits each ``Sample`` by each ``Method`` and returns pooled scores. Samples come from a user's own arrays
(``view_samples``) or are synthetic (``make_sample``, PartBench). ``partdr evaluate`` has the same as a command.
"""

from typing import TYPE_CHECKING

from ._lazy import lazy_names

_EXPORTS = {
    "view_samples": "lab.evaluation.datasets.views",
    "Views": "lab.evaluation.datasets.views",
    "ViewSelection": "lab.evaluation.datasets.views",
    "evaluate": "lab.evaluation.evaluate",
    "Method": "lab.evaluation.evaluate",
    "METHODS": "lab.evaluation.evaluate",
    "make_sample": "lab.evaluation.partbench.samples",
    "real_methods": "lab.evaluation.real",
    "Sample": "inputs.sample",
}

__all__ = sorted(_EXPORTS)

if TYPE_CHECKING:
    from .inputs.sample import Sample as Sample
    from .lab.evaluation.datasets.views import Views as Views
    from .lab.evaluation.datasets.views import ViewSelection as ViewSelection
    from .lab.evaluation.datasets.views import view_samples as view_samples
    from .lab.evaluation.evaluate import METHODS as METHODS
    from .lab.evaluation.evaluate import Method as Method
    from .lab.evaluation.evaluate import evaluate as evaluate
    from .lab.evaluation.partbench.samples import make_sample as make_sample
    from .lab.evaluation.real import real_methods as real_methods
else:
    __getattr__ = lazy_names(__name__, _EXPORTS)


def __dir__() -> list[str]:
    """Public names alone."""
    return list(__all__)
