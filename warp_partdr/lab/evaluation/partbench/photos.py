"""PartBench's level "photo": the same people, shaded. A fit gets only what the packaged detector finds."""

from __future__ import annotations

import zlib
from functools import lru_cache

import numpy as np
import torch

from ....errors import InputError
from ....inputs.person import PersonInputs
from ....pipelines.photo import person_in_photo
from ...synthetic.partbench_people import NUM_PEOPLE, SEED, make_person
from ...synthetic.people import anny_mesh
from ...synthetic.rng import TorchRng
from ...synthetic.shading import shade_people

PHOTO = "photo"
# Photos of a person, until somebody is found in one: of 200 people, 195 are in the first, 4 in one of the next 7, and
# number 28, who bends down, seen from behind and cut off, in the 21st.
TRIES = 40


def shade_person(index: int, attempt: int = 0) -> np.ndarray:
    """Photo of person ``index``; each attempt has clothes, light and background of its own, (H, W, 3), uint8."""
    person = make_person(index)
    seed = np.random.default_rng([SEED, index, zlib.crc32(PHOTO.encode()), attempt]).integers(2**62)
    vertices = torch.from_numpy(person.vertices)[None]
    return shade_people(vertices, anny_mesh(), person.camera, person.parts.shape, TorchRng(int(seed), "cpu"))[0][0]


@lru_cache(maxsize=NUM_PEOPLE)
def find_in_photo(index: int) -> tuple[PersonInputs, int]:
    """The input of a fit of person ``index`` as ``fit_photo`` has it, and the number of photos nobody was found in.

    Where nobody is found, there is nothing to fit: clothes, light and background are drawn again.

    Raises:
        InputError: If nobody is found in any of ``TRIES`` photos.
    """
    for attempt in range(TRIES):
        try:
            return person_in_photo(shade_person(index, attempt)), attempt
        except InputError:
            continue
    raise InputError(f"person {index}: found in none of {TRIES} photos; expected one that shows a person")
