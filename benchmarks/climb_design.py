"""The numbers of a climb that are searched for, as a vector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon.robotics.climb.fields import Fields, Well
from recon.robotics.climb.paths import Step
from recon.robotics.climb.recipe import Primitive, Recipe

Array = NDArray[np.float64]


class Number(NamedTuple):
    """One number of the design: its scale, the trust region's unit; its bounds; whether its logarithm is moved."""

    name: str
    scale: float
    low: float
    high: float
    log: bool = False


def _pair(number: Number) -> tuple[Number, Number]:
    """The same for the front and for the rear legs."""
    return number._replace(name=f"{number.name}.front"), number._replace(name=f"{number.name}.rear")


FIELD_NUMBERS = (
    *_pair(Number("radial.natural", 0.003, 0.085, 0.142)),
    *_pair(Number("radial.least", 0.003, 0.060, 0.130)),
    *_pair(Number("radial.most", 0.003, 0.100, 0.160)),
    Number("swing.gain", 0.3, 1e-5, 0.1, True),
    *_pair(Number("swing.natural", 0.05, -0.8, 0.8)),
    *_pair(Number("swing.least", 0.05, -1.6, 0.0)),
    *_pair(Number("swing.most", 0.05, 0.0, 1.6)),
    Number("flap.gain", 0.3, 1e-5, 0.1, True),
    Number("flap.natural", 0.03, -0.2, 0.6),
    Number("flap.least", 0.03, -0.6, 0.1),
    Number("flap.most", 0.03, 0.1, 1.2),
    Number("balance.gain", 0.3, 1e-3, 10.0, True),
)
PATH_NUMBERS = (Number("rise_rad", 0.05, 0.6, 2.2), Number("lower_rad", 0.05, 0.6, 2.2))
"""Of each primitive, as are the fields' numbers. The rest stays: the radial gain, which sets the unit of force, and the
sharpness of the walls."""
ORDERED = ("least", "natural", "most")
STANCE_NUMBERS = (
    *(Number(f"forward {k + 1}", 0.004, -0.15, 0.15) for k in range(4)),
    *(Number(f"width {k + 1}", 0.002, -0.12, 0.12) for k in range(4)),
    Number("edge", 0.004, -0.1, 0.5),
)
FOOTFALL = Number("footfall", 0.004, -0.02, 0.16)


@dataclass(frozen=True, eq=False)
class Design:
    """A recipe as a vector of numbers, in units of their scales. footfalls: whether those may change."""

    recipe: Recipe
    numbers: tuple[Number, ...]
    footfalls: bool

    @classmethod
    def of(cls, recipe: Recipe, footfalls: bool) -> Design:
        each = [
            number._replace(name=f"{k}.{number.name}")
            for k in range(len(recipe.primitives))
            for number in (*FIELD_NUMBERS, *PATH_NUMBERS)
        ]
        falls = [FOOTFALL] * len(recipe.footfalls) if footfalls else []
        return cls(recipe, (*each, *STANCE_NUMBERS, *falls), footfalls)

    def vector(self) -> Array:
        """(n,)"""
        r = self.recipe
        values = []
        for p in r.primitives:
            values += [*(_get(p.fields, n.name) for n in FIELD_NUMBERS), p.rise_rad, p.lower_rad]
        values += [*r.stance_m[:, 1], *r.stance_m[:, 0], r.step.edge_m]
        values += [f.forward_m for f in r.footfalls] if self.footfalls else []
        return self._scaled(np.array(values, float))

    def bounds(self) -> tuple[Array, Array]:
        return self._scaled(np.array([n.low for n in self.numbers])), self._scaled(
            np.array([n.high for n in self.numbers])
        )

    def order(self) -> Array:
        """(m, n): differences that must not be negative, least to natural to most."""
        place, rows = {n.name: k for k, n in enumerate(self.numbers)}, []
        for name, k in place.items():
            for a, b in pairwise(ORDERED):
                if f".{a}" in name:
                    row = np.zeros(len(self.numbers))
                    row[[k, place[name.replace(f".{a}", f".{b}")]]] = -1.0, 1.0
                    rows.append(row)
        return np.array(rows)

    def read(self, vectors: Array) -> Numbers:
        """Of vectors (N, n)."""
        scale = np.array([n.scale for n in self.numbers])
        log = np.array([n.log for n in self.numbers])
        raw = vectors * scale
        values = np.where(log, np.exp(np.where(log, raw, 0.0)), raw)
        count = len(self.recipe.primitives)
        per = len(FIELD_NUMBERS) + len(PATH_NUMBERS)
        field = values[:, : count * per].reshape(-1, count, per)
        rest = values[:, count * per :]
        falls = rest[:, 9:] if self.footfalls else np.array([[f.forward_m for f in self.recipe.footfalls]])
        return Numbers(
            field[..., :-2],
            field[..., -2],
            field[..., -1],
            np.stack([rest[:, 4:8], rest[:, :4]], axis=-1),
            rest[:, 8],
            np.broadcast_to(falls, (len(values), falls.shape[1])),
        )

    def recipe_of(self, vector: Array) -> Recipe:
        n = self.read(vector[None])
        r = self.recipe
        falls = iter(n.forward_m[0])
        primitives = tuple(
            Primitive(
                p.name,
                tuple(replace(f, forward_m=float(next(falls))) for f in p.footfalls),
                _fields(p.fields, {m.name: x for m, x in zip(FIELD_NUMBERS, n.fields[0, k], strict=True)}),
                float(n.rise_rad[0, k]),
                float(n.lower_rad[0, k]),
            )
            for k, p in enumerate(r.primitives)
        )
        return replace(
            r,
            step=Step(float(n.edge_m[0]), r.step.height_m),
            stance_m=n.stance_m[0],
            primitives=primitives,
        )

    def _scaled(self, values: Array) -> Array:
        log = np.array([n.log for n in self.numbers])
        return np.where(log, np.log(np.where(log, values, 1.0)), values) / np.array([n.scale for n in self.numbers])


class Numbers(NamedTuple):
    """Of N designs: fields (N, primitives, FIELD_NUMBERS), rise_rad and lower_rad (N, primitives), stance_m (N, 4, 2),
    edge_m (N,), forward_m (N, footfalls)."""

    fields: Array
    rise_rad: Array
    lower_rad: Array
    stance_m: Array
    edge_m: Array
    forward_m: Array


def _get(fields: Fields, name: str) -> float:
    part, what, *legs = name.split(".")
    if part == "balance":
        return float(np.asarray(fields.balance_gain))
    values = np.broadcast_to(getattr(getattr(fields, part), what), 4)
    return float(values[1 if legs == ["rear"] else 0])


def _fields(fields: Fields, values: Mapping[str, Array]) -> Fields:
    """With the values (...) by the names of `FIELD_NUMBERS`, each for all legs or for a pair, in place of its own."""
    wells = {}
    for part in ("radial", "swing", "flap"):
        named = {}
        for name, x in values.items():
            where, what, *legs = name.split(".")
            if where == part and not legs:
                named[what] = np.asarray(x)[..., None]
            elif where == part and legs == ["front"]:
                rear = values[f"{part}.{what}.rear"]
                named[what] = np.stack([x, rear, x, rear], axis=-1)  # in the order of `walker.LEGS`
        wells[part] = replace(getattr(fields, part), **named)
    return Fields(**wells, balance_gain=values["balance.gain"], balance_sharpness=fields.balance_sharpness)


def sampled(recipe: Recipe, n: Numbers, primitive: NDArray[np.int64]) -> Fields:
    """The fields of N designs, in samples that belong to the primitives (S,)."""

    def well(part: str) -> Well:
        wells = [getattr(p.fields, part) for p in recipe.primitives]
        whole = {f.name: np.array([np.broadcast_to(getattr(w, f.name), 4) for w in wells]) for f in fields(Well)}
        return Well(**{name: values[primitive] for name, values in whole.items()})

    sharp = np.array([float(np.asarray(p.fields.balance_sharpness)) for p in recipe.primitives])[primitive]
    base = Fields(well("radial"), well("swing"), well("flap"), 1.0, sharp)
    return _fields(base, {m.name: n.fields[:, primitive, j] for j, m in enumerate(FIELD_NUMBERS)})
