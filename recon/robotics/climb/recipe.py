"""What a climb is made of: footfalls in primitives with their fields, the step, the stance and speeds; and its file.

In a file, legs are numbered left front, left rear, right front, right rear, as the published footfalls are; places are
given to the right and forwards. In Python legs stand in the order of `LEGS`, and x is forwards, y left, z up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field

from recon.base.arrays import Array
from recon.base.documents import read_toml, validated

RECIPES = Path(__file__).parent / "recipes"
IN_FILES = (0, 2, 1, 3)
"""Index into `LEGS` of the legs of a file, and the other way round."""
PLANAR, SPATIAL = (0, 1, 2, 4), (0, 1, 2, 3, 4, 5)
"""Degrees of freedom of a torso: x, y, z and pitch, or roll and yaw too."""
LARGEST = 1e9
Number = Annotated[float, Field(strict=True, gt=-LARGEST, lt=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, lt=LARGEST, allow_inf_nan=False)]
"""In a recipe's file: what more or less than these would be can only be damage."""
FORBID = ConfigDict(extra="forbid", frozen=True)
"""A name that is not known is a mistake in any table."""


def _all_legs(given: Any) -> Any:
    """One number for all legs, or two: of the front and of the rear legs."""
    front, rear = given if isinstance(given, list) and len(given) == 2 else (given, given)
    return (front, front, rear, rear)


_Legs = Annotated[tuple[Number, Number, Number, Number], BeforeValidator(_all_legs)]
_PositiveLegs = Annotated[tuple[Positive, Positive, Positive, Positive], BeforeValidator(_all_legs)]


@dataclass(frozen=True)
class _Well:
    """A potential of a coordinate q of each leg, with a wall at either end. Raises ValueError."""

    __pydantic_config__ = FORBID
    gain: _PositiveLegs
    """Slope per unit of q."""
    natural: _Legs
    """The q of the least energy."""
    least: _Legs
    """The q of the lower wall."""
    most: _Legs
    """The q of the upper wall."""
    low: _PositiveLegs
    """Sharpness of the lower wall, per unit of q."""
    high: _PositiveLegs
    """Sharpness of the upper wall, per unit of q."""

    def __post_init__(self) -> None:
        if any(not a <= b <= c for a, b, c in zip(self.least, self.natural, self.most, strict=True)):
            raise ValueError("least <= natural <= most")

    def slope(self, q: Array) -> Array:
        """At q (legs,): almost flat between least and most (the dead zone), and steep beyond."""
        off, above, below = (q - np.array(of) for of in (self.natural, self.most, self.least))
        return np.array(self.gain) * off * (np.exp(self.high * above) + np.exp(-np.array(self.low) * below))


@dataclass(frozen=True)
class _Balance:
    """What pulls the torso over its feet."""

    __pydantic_config__ = FORBID
    gain: Positive
    """Force far from the centroid."""
    sharpness: Positive
    """Per metre."""


@dataclass(frozen=True)
class Fields:
    """The wells of the legs, and what balances the torso."""

    __pydantic_config__ = FORBID
    radial: _Well
    swing: _Well
    flap: _Well
    balance: _Balance


@dataclass(frozen=True)
class Step:
    """A step up across the way: the ground is level at 0 as far as edge_m forward (x), and at height_m beyond."""

    __pydantic_config__ = FORBID
    edge_m: Number
    height_m: Number

    def distance_m(self, points_m: Array) -> Array:
        """(...): from points (..., 3) to the ground or the step, whichever is nearer, negative inside."""
        x, z = points_m[..., 0] - self.edge_m, points_m[..., 2] - self.height_m
        away = np.hypot(np.maximum(-x, 0), np.maximum(z, 0))
        return np.minimum(points_m[..., 2], np.where((x > 0) & (z < 0), -np.minimum(x, -z), away))

    def corner_m(self, points_m: Array) -> Array:
        """(...): from points (..., 3) to the step's edge, negative inside the step."""
        x, z = points_m[..., 0] - self.edge_m, points_m[..., 2] - self.height_m
        return np.where((x > 0) & (z < 0), -1.0, 1.0) * np.hypot(x, z)


@dataclass(frozen=True)
class _Footfall:
    """A step that one leg takes."""

    __pydantic_config__ = FORBID
    leg: Annotated[int, Field(strict=True, ge=1, le=4), AfterValidator(lambda number: IN_FILES[number - 1])]
    """Index into `LEGS`."""
    forward_m: Number
    up_m: Number
    sideways_m: Number = 0.0
    """To the right."""

    @property
    def vector_m(self) -> Array:
        return np.array([self.forward_m, -self.sideways_m, self.up_m])


@dataclass(frozen=True)
class Primitive:
    """Some footfalls in the same fields."""

    __pydantic_config__ = FORBID
    name: str
    rise_rad: Positive
    """Angle of the feet's paths."""
    lower_rad: Positive
    """Angle of the feet's paths."""
    footfalls: Annotated[tuple[_Footfall, ...], Field(min_length=1)]
    fields: Fields


@dataclass(frozen=True)
class _Swing:
    """How a foot moves: its path's clearance above the higher end, and its speeds by phase."""

    __pydantic_config__ = FORBID
    clearance_m: Positive
    rise_m_s: Positive
    traverse_m_s: Positive
    lower_m_s: Positive


@dataclass(frozen=True)
class _Pace:
    """How far the torso goes in a frame, at most."""

    __pydantic_config__ = FORBID
    max_step_m: Positive
    max_turn_rad: Positive


@dataclass(frozen=True)
class Recipe:
    """What a climb is planned from."""

    __pydantic_config__ = FORBID
    robot: str
    """Name of its description."""
    dofs: Literal[4, 6]
    """How many the torso has."""
    fps: Positive
    stance_m: Annotated[tuple[tuple[Number, Number], ...], Field(min_length=4, max_length=4)]
    """Where the feet stand at first, right and forward, in the order of the file."""
    step: Step
    swing: _Swing
    motion: _Pace
    primitives: Annotated[tuple[Primitive, ...], Field(min_length=1)]
    about: str = ""
    """What it is for, and where its numbers are from."""

    @property
    def free(self) -> tuple[int, ...]:
        """The torso's degrees of freedom."""
        return PLANAR if self.dofs == 4 else SPATIAL

    @property
    def feet_m(self) -> Array:
        """(4, 3): where they stand at first."""
        right, forward = np.array(self.stance_m)[list(IN_FILES)].T
        return np.column_stack([forward, -right, np.zeros(4)])


def bundled() -> list[str]:
    return sorted(p.stem for p in RECIPES.glob("*.toml"))


def load_recipe(recipe: str | Path) -> Recipe:
    """A bundled recipe by name, or a file. Raises InputError."""
    path = RECIPES / f"{recipe}.toml" if str(recipe) in bundled() else Path(recipe)
    table = read_toml(path, f"a recipe of a climb: a TOML file, or one of {', '.join(bundled())}")
    return validated(Recipe, table, path)


def raised(recipe: Recipe, height_m: float) -> Recipe:
    """For a step of another height: all heights in proportion."""
    ratio = height_m / recipe.step.height_m
    primitives = tuple(
        replace(p, footfalls=tuple(replace(f, up_m=f.up_m * ratio) for f in p.footfalls)) for p in recipe.primitives
    )
    return replace(recipe, step=replace(recipe.step, height_m=height_m), primitives=primitives)
