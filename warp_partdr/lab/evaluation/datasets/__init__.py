"""Data sets that fits are evaluated on: each reader yields ``Sample`` records, one a person.

What a user has to get, and from where, is in the errors and in docs/how_to/evaluate.md. Nothing is ever unpickled.
"""

from __future__ import annotations

from ....inputs.sample import Sample
from .folder import read_folder
from .lsp import read_lsp
from .real import read_real
from .spin import read_human36m, read_pw3d, read_spin
from .views import Views, ViewSelection, read_views, view_samples, write_views

__all__ = [
    "Sample",
    "ViewSelection",
    "Views",
    "read_folder",
    "read_human36m",
    "read_lsp",
    "read_pw3d",
    "read_real",
    "read_spin",
    "read_views",
    "view_samples",
    "write_views",
]
