"""Run the notebook from top to bottom and keep its outputs in it: python scripts/run_notebook.py.

It needs nbclient and ipykernel, of the extra test. Times in the outputs are those of the machine that ran it.
"""

from __future__ import annotations

import tempfile
from base64 import b64decode, b64encode
from io import BytesIO
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from PIL import Image

NOTEBOOK = Path(__file__).resolve().parent.parent / "demos" / "partdr.ipynb"
_HANG = 1200  # [s] limit of a cell: only what hangs takes so long
_COLOURS = 256  # of a picture, which has a third of the size then


def executed(folder: Path) -> Any:
    """Notebook with its outputs, run in a folder."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    place = {"metadata": {"path": str(folder)}}
    client = NotebookClient(notebook, timeout=_HANG, resources=place, record_timing=False, coalesce_streams=True)
    client.execute()
    return notebook


def kept(output: Any) -> bool:
    """True for all outputs but the line in which Warp says that there is no GPU."""
    return not (output.output_type == "stream" and "NVIDIA CUDA driver" in output.text)


def with_fewer_colours(png: str) -> str:
    """Picture in base64 with a palette."""
    small = BytesIO()
    Image.open(BytesIO(b64decode(png))).convert("RGB").quantize(_COLOURS).save(small, "PNG", optimize=True)
    return b64encode(small.getvalue()).decode()


def keep_outputs(notebook: Any) -> None:
    """Write the notebook with its outputs, made small."""
    notebook.metadata.pop("language_info", None)  # tells which Python ran it
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if kept(output)]
            for output in cell.outputs:
                if "image/png" in output.get("data", {}):
                    output.data["image/png"] = with_fewer_colours(output.data["image/png"])
    NOTEBOOK.write_text(nbformat.writes(notebook) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as elsewhere:
        result = executed(Path(elsewhere))
    keep_outputs(result)
