"""Bodies have the statures, girths and limbs of a population, and its ages."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from warp_partdr.lab.synthetic.population import MEASURES, QUANTILES, population
from warp_partdr.models.anny import anny
from warp_partdr.models.measuring import measure_body, statures

COUNT = 6000


def draws(count: int = COUNT) -> torch.Tensor:
    return torch.rand(count, len(QUANTILES), generator=torch.Generator().manual_seed(1))


def person(**quantiles: float) -> torch.Tensor:
    """Quantiles (1, 15) of a person who is average but for some."""
    values = {"sex": 0.25, **{name.replace(" ", "_"): 0.5 for name in QUANTILES[1:]}, **quantiles}
    return torch.tensor([list(values.values())])


def bones(shape: torch.Tensor, start: str, end: str) -> torch.Tensor:
    model = anny()
    points = model.landmarks(model.rest(shape), (f"left_{start}", f"left_{end}"))
    return (points[:, 0] - points[:, 1]).norm(dim=-1)


def test_adults_are_as_tall_as_adults_are(device: str) -> None:
    quantiles = draws().to(device)
    people = population(device)
    years, tall = people.years(quantiles), people.statures(people.shapes(quantiles))
    adult, woman = years >= 18, quantiles[:, 0] >= 0.5
    assert 0.08 < (~adult).float().mean() < 0.12
    assert (years.min() < 3.5, years.max() > 79) == (True, True)
    for sex, mean, spread in ((~woman, 1.756, 0.082), (woman, 1.629, 0.076)):
        of_sex = tall[sex & adult]
        assert of_sex.mean().item() == pytest.approx(mean, abs=0.005)
        assert of_sex.std().item() == pytest.approx(spread, abs=0.004)
    assert tall.max() < 2.05
    ten = (years > 9.5) & (years < 10.5)
    assert tall[ten].mean().item() == pytest.approx(1.38, abs=0.03)  # WHO: 1.378 m of boys, 1.386 m of girls


def test_children_are_as_tall_as_the_tables_of_the_who_say() -> None:
    """WHO Growth Reference 2007, height for age, medians [m] of boys and girls, between the ages that are stored."""
    people = population()
    medians = {7: (1.2173, 1.2081), 10: (1.3778, 1.3864), 13: (1.5604, 1.5637), 16: (1.7290, 1.6252)}
    for years, tall in medians.items():
        for sex, wanted in zip((0.25, 0.75), tall, strict=True):
            child = person(sex=sex, age=(years - 3) / 15 * 0.1)
            assert people.years(child).item() == pytest.approx(years, abs=0.01)
            assert -0.025 < people.statures(people.shapes(child)).item() - wanted < 0.01


def test_statures_are_those_of_whole_bodies(device: str) -> None:
    people = population(device)
    shape = people.shapes(draws(40).to(device))
    assert (people.statures(shape) - statures(anny(device), shape)).abs().max() < 0.006


def test_a_persons_body_is_the_same_in_any_company() -> None:
    people, quantiles = population(), draws(64)
    torch.testing.assert_close(people.shapes(quantiles)[7:8], people.shapes(quantiles[7:8]), rtol=0, atol=2e-4)


def test_measures_are_those_that_were_learned() -> None:
    people, quantiles = population(), draws()
    adult = people.years(quantiles) >= 18
    for sex, first in (("men", quantiles[:, 0] < 0.5), ("women", quantiles[:, 0] >= 0.5)):
        shape = people.shapes(quantiles[adult & first])
        measured = torch.nn.functional.pad(shape, (0, 1), value=1.0) @ people.measure_model.T
        shares = dict(zip(MEASURES[1:], (measured[:, 1:] / people.statures(shape)[:, None]).mean(0), strict=True))
        # Tape measures of ANSUR II as shares of the stature; limbs between joints.
        wanted = {"men": (0.536, 0.603, 0.581, 0.155), "women": (0.529, 0.582, 0.627, 0.151)}[sex]
        for name, share in zip(("waist girth", "chest girth", "hip girth", "forearm length"), wanted, strict=True):
            assert shares[name].item() == pytest.approx(share, rel=0.05), (sex, name)


def test_each_quantile_changes_its_own_measure() -> None:
    people = population()
    tall, short = (people.shapes(person(stature=value)) for value in (0.9, 0.1))
    assert people.statures(tall) - people.statures(short) > 0.18
    girths = [measure_body(anny(), anny().rest(people.shapes(person(waist_girth=value))))[0] for value in (0.1, 0.9)]
    assert girths[1][2] / girths[0][2] > 1.25
    assert abs(girths[1][0] / girths[0][0] - 1) < 0.005
    arms = [bones(people.shapes(person(forearm_length=value)), "elbow", "wrist") for value in (0.1, 0.9)]
    assert arms[1] / arms[0] > 1.03
    muscles = [people.shapes(person(muscle=value)) for value in (0.1, 0.9)]
    assert (muscles[1] - muscles[0]).abs().max() > 0.2


def test_children_are_no_small_adults() -> None:
    people = population()
    child, adult = people.shapes(person(age=0.02)), people.shapes(person(age=0.4))
    leg = [bones(shape, "hip", "ankle") / people.statures(shape) for shape in (child, adult)]
    assert leg[0] < leg[1]
    assert people.years(person(age=0.05)).item() == pytest.approx(10.5)


def test_extreme_people_are_people() -> None:
    corners = np.random.default_rng(0).integers(2, size=(200, len(QUANTILES))).astype(np.float32)
    shape = population().shapes(torch.from_numpy(corners))
    assert shape.isfinite().all()
    assert population().statures(shape).min() > 0.8


def test_quantiles_of_other_shapes_and_dtypes_are_refused() -> None:
    assert population().shapes(torch.rand(0, len(QUANTILES))).shape == (0, 20)
    for wrong in (torch.rand(2, 3), torch.rand(2, len(QUANTILES), dtype=torch.float64)):
        with pytest.raises(ValueError, match="quantiles: "):
            population().shapes(wrong)
