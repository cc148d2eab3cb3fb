"""People as a population has them: Anny bodies with the statures, girths, limbs and ages that people have.

A person is a point of the unit cube: a quantile of each of ``QUANTILES``. The logarithms of tape measures have a normal
distribution for each sex, which ``scripts/learn_population.py`` learned from ANSUR II (US Army, 2012): 4,082 men and
1,986 women. Children's statures are those of the World Health Organization's growth references (see
``_CHILD_STATURES``). Anny's phenotype values alone make arms too short, and no adult as heavy as the population's. So
a body is moved from there in shape space, as little as its measures demand.
"""

from __future__ import annotations

import json
from importlib import resources

import torch

from ...interop.checks import check_tensor
from ...interop.device_cache import device_cache
from ...models.anny import PHENOTYPE_ANCHORS, anny, anny_shape

# Tape measures, in the order in which each has a normal quantile of its own, given those before it.
MEASURES = (
    "stature",
    "waist girth",
    "chest girth",
    "hip girth",
    "thigh girth",
    "shoulder height",
    "shoulder width",
    "upper leg length",
    "lower leg length",
    "upper arm length",
    "forearm length",
)
QUANTILES = ("sex", "age", "muscle", "proportions", *MEASURES)

# Soldiers are chosen by their size and fitness; people are not. Spreads are those of ANSUR, so many times.
_WIDER = {"stature": 1.2, "waist girth": 1.25}
_MOST = 0.995  # quantile of measures, beyond which nobody is

# Shares of people up to ages [years]: a tenth are children from 3 on.
_AGES = (0.0, 0.1, 0.82, 1.0), (3.0, 18.0, 60.0, 80.0)
_ANNYS_AGES = (1.0, 11.0, 20.0, 90.0), (0.0, 1 / 3, 2 / 3, 1.0)  # [years], and Anny's phenotype value
# Median statures [m] of boys and girls of ages [years], to the millimetre. At 3 years (day 1,096): WHO Child Growth
# Standards (2006), lenanthro.txt of github.com/WorldHealthOrganization/anthro at 272a55e. From 6 years on: WHO Growth
# Reference (2007), hfawho2007.txt of github.com/WorldHealthOrganization/anthroplus at 4a303d4 (column m). Between these
# ages the interpolation is up to 20 mm below the tables.
_CHILD_AGES = (3.0, 6.0, 9.0, 12.0, 15.0, 18.0)
_CHILD_STATURES = (0.961, 1.160, 1.326, 1.491, 1.690, 1.761), (0.951, 1.151, 1.325, 1.512, 1.617, 1.631)
_CHILD_SPREAD = 0.045  # standard deviation of the logarithm of their statures; the tables' column s: 0.039 to 0.048
_ADULT = 18.0  # [years]
_CHILDLIKE = 10.0  # [years]: up to this age trunk, legs and girths are as Anny's children have them

_GENDERS = 0.15  # how far Anny's men and women are from its extremes, at most
# Muscle and children's weight as phenotype values: spread, and what a standard deviation of the waist's girth changes.
_MUSCLE_SPREAD, _MUSCLE_LOSS, _WEIGHT_GAIN = 0.2, 0.12, 0.2
# Longer arms are what tells Anny's men from women, too: how much more a move in that direction counts than in others.
_KEEP_GENDER = 20.0
# How far measures of a body may stay off, as shares, where shapes would have to be moved by a standard deviation.
_TOLERANCES = {"stature": 0.003, "girth": 0.02, "height": 0.01, "width": 0.01, "length": 0.01}

_GENDER, _AGE, _MUSCLE, _WEIGHT, _HEIGHT, _PROPORTIONS = range(len(PHENOTYPE_ANCHORS))
_STATURE, _WAIST = MEASURES.index("stature"), MEASURES.index("waist girth")


class Population:
    """Shapes of Anny that a population has, on a device.

    Attributes:
        measure_model: Measures [m] as linear functions of shape values and 1, shape (11, 21).
    """

    def __init__(self, device: torch.device | str = "cpu") -> None:
        path = resources.files("warp_partdr").joinpath("assets/population.json")
        learned = json.loads(path.read_text(encoding="utf-8"))
        if tuple(learned["measures"]) != MEASURES:
            raise ValueError(f"population.json: measures {learned['measures']}; expected {list(MEASURES)}")

        def numbers(values: object) -> torch.Tensor:
            return torch.tensor(values, dtype=torch.float32, device=device)

        self._means = numbers([learned[sex]["log_means"] for sex in ("men", "women")])  # (2, 11)
        wider = numbers([_WIDER.get(name, 1.0) for name in MEASURES])
        self._factors = numbers([learned[sex]["log_factors"] for sex in ("men", "women")]) * wider  # (2, 11, 11)
        self.measure_model = numbers(learned["measure_model"])
        self._ages, self._annys_ages = (tuple(map(numbers, curve)) for curve in (_AGES, _ANNYS_AGES))
        self._child_ages, self._child_statures = numbers(_CHILD_AGES), numbers(_CHILD_STATURES).log()
        self._arms = torch.tensor([name in ("upper arm length", "forearm length") for name in MEASURES], device=device)
        self._typical = self._means.exp().mean(0)

        # Ridge regression: the least move that changes measures so. Shape values have unit variance.
        tolerances = numbers([_TOLERANCES[name.rpartition(" ")[2]] for name in MEASURES]) * self._typical
        scaled = self.measure_model[:, :-1] / tolerances[:, None]  # (11, 20)
        people = torch.rand(512, len(PHENOTYPE_ANCHORS), generator=torch.Generator().manual_seed(0)).to(device)
        shape = anny_shape(people)
        manly = shape - anny_shape(torch.cat([1 - people[:, :1], people[:, 1:]], dim=1))
        manly = torch.nn.functional.normalize(((0.5 - people[:, :1]) * manly).mean(0), dim=0)
        ridge = torch.eye(len(manly), device=device) + _KEEP_GENDER * manly[:, None] * manly
        self._gain = torch.linalg.solve(scaled.mT @ scaled + ridge, scaled.mT) / tolerances  # (20, 11)

        # Heights [m] of vertices that are somebody's lowest or highest, linear in shape values and 1, (N, 21) each.
        model = anny(device)
        upward = torch.cat([model.shape_directions[..., 1], model.rest_vertices[None, :, 1]]).mT.contiguous()
        heights = torch.nn.functional.pad(shape, (0, 1), value=1.0) @ upward.mT
        self._low, self._high = (upward[ends.unique()] for ends in (heights.argmin(1), heights.argmax(1)))

    @torch.no_grad()
    def shapes(self, quantiles: torch.Tensor) -> torch.Tensor:
        """Shape values for ``anny().pose`` of people, shape (B, 20).

        Args:
            quantiles: One of each of ``QUANTILES``, 0 to 1, shape (B, 15), float32. Men have the lower half of sexes.

        Raises:
            ValueError: If the shape, dtype or device differs.
        """
        check_tensor(
            "quantiles",
            quantiles,
            (None, len(QUANTILES)),
            dtypes=(torch.float32,),
            like=("population", self.measure_model),
        )
        woman = quantiles[:, 0] >= 0.5
        sex = woman.long()
        years = self.years(quantiles)
        grown = ((years - _CHILDLIKE) / (_ADULT - _CHILDLIKE)).clamp(0.0, 1.0)
        normal = torch.special.ndtri(quantiles[:, 2:].clamp(1 - _MOST, _MOST))
        muscle, scores = normal[:, 0], normal[:, 2:]
        stature, ratios = self._wanted(sex, years, scores)

        phenotypes = torch.empty_like(quantiles[:, : len(PHENOTYPE_ANCHORS)])
        manner = _GENDERS * (2 * quantiles[:, 0] - sex)
        phenotypes[:, _GENDER] = torch.where(woman, 1 - manner, manner)
        phenotypes[:, _AGE] = _interpolate(years, *self._annys_ages)
        phenotypes[:, _MUSCLE] = (0.5 + _MUSCLE_SPREAD * muscle - _MUSCLE_LOSS * scores[:, _WAIST]).clamp(0.05, 0.95)
        phenotypes[:, _WEIGHT] = 0.5
        phenotypes[:, _PROPORTIONS] = quantiles[:, 3]
        phenotypes[:, _HEIGHT] = self._height(phenotypes, stature)
        weight = self._weight(phenotypes, stature * ratios[:, _WAIST].exp())
        phenotypes[:, _WEIGHT] = torch.lerp((0.5 + _WEIGHT_GAIN * scores[:, _WAIST]).clamp(0.0, 1.0), weight, grown)

        shape = anny_shape(phenotypes)
        measured = self._measured(shape)
        natural = (measured / stature[:, None]).log()
        share = torch.where(self._arms, 1.0, grown[:, None])
        wanted = stature[:, None] * torch.lerp(natural, ratios, share).exp()
        shape = shape + (wanted - measured) @ self._gain.mT
        return self._resized(shape, stature)

    def years(self, quantiles: torch.Tensor) -> torch.Tensor:
        """Ages of people with quantiles (B, 15) [years], shape (B,)."""
        return _interpolate(quantiles[:, 1], *self._ages)

    def statures(self, shape: torch.Tensor) -> torch.Tensor:
        """Heights of standing people of shape values (B, 20), shape (B,) [m], from a few of the vertices."""
        extended = torch.nn.functional.pad(shape, (0, 1), value=1.0)
        return (extended @ self._high.mT).amax(1) - (extended @ self._low.mT).amin(1)

    def _wanted(
        self, sex: torch.Tensor, years: torch.Tensor, scores: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Statures [m] (B,), and logarithms of measures as shares of them (B, 11)."""
        child, means, factors = years < _ADULT, self._means[sex], self._factors[sex]
        medians = [_interpolate(years, self._child_ages, curve) for curve in self._child_statures]
        young = torch.where(sex == 1, medians[1], medians[0]) + _CHILD_SPREAD * scores[:, _STATURE]
        # A tall child is no tall adult: its proportions are those of the mean adult's stature.
        own = scores.clone()
        own[:, _STATURE] = torch.where(child, 0.0, scores[:, _STATURE])
        logs = means + (factors @ own[..., None])[..., 0]
        stature = torch.where(child, young, logs[:, _STATURE]).exp()
        return stature, logs - logs[:, _STATURE, None]

    def _measured(self, shape: torch.Tensor) -> torch.Tensor:
        """Measures of bodies of shape values (B, 20), shape (B, 11) [m]."""
        return torch.addmm(self.measure_model[:, -1], shape, self.measure_model[:, :-1].mT)

    def _height(self, phenotypes: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """Phenotype value with which people have statures (B,) [m], which are linear in it, shape (B,)."""
        low, high = (self.statures(shape) for shape in _varied(phenotypes, _HEIGHT, (0.0, 1.0)))
        return ((wanted - low) / (high - low)).clamp(0.0, 1.0)

    def _weight(self, phenotypes: torch.Tensor, girth: torch.Tensor) -> torch.Tensor:
        """Phenotype value with which waists have girths (B,) [m], which are linear between anchors, shape (B,)."""
        shapes = _varied(phenotypes, _WEIGHT, PHENOTYPE_ANCHORS["weight"])
        light, usual, heavy = (self._measured(shape)[:, _WAIST] for shape in shapes)
        lower, upper = (girth - light) / (usual - light), (girth - usual) / (heavy - usual)
        return (lower.clamp(0.0, 1.0) + upper.clamp(0.0, 1.0)) / 2

    def _resized(self, shape: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """Shapes (B, 20) of bodies that are enlarged a little, until they have statures (B,) [m]."""
        larger = self._measured(shape) @ self._gain.mT  # makes all measures nearly twice as large
        gained = larger @ self.measure_model[_STATURE, :-1]
        return shape + ((wanted - self.statures(shape)) / gained)[:, None] * larger


@device_cache(8)
def population(device: torch.device | str = "cpu") -> Population:
    """The population on a device, read once."""
    return Population(device)


def _varied(phenotypes: torch.Tensor, index: int, values: tuple[float, ...]) -> tuple[torch.Tensor, ...]:
    """Shape values (B, 20) of people with each of some values of one phenotype."""
    some = phenotypes.repeat(len(values), 1, 1)
    some[..., index] = some.new_tensor(values)[:, None]
    return anny_shape(some.flatten(0, 1)).chunk(len(values))


def _interpolate(values: torch.Tensor, knots: torch.Tensor, levels: torch.Tensor) -> torch.Tensor:
    """A piecewise linear function of values (B,), by its levels at knots; constant beyond them."""
    index = torch.searchsorted(knots, values.contiguous()).clamp(1, len(knots) - 1)
    share = (values - knots[index - 1]) / (knots[index] - knots[index - 1])
    return torch.lerp(levels[index - 1], levels[index], share.clamp(0.0, 1.0))
