"""What a climb is made of: footfalls in primitives with their fields, the step, the stance and speeds; and its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from recon.arrays import Array
from recon.documents import read_toml
from recon.errors import InputError, Problem
from recon.files import staged_file
from recon.robot.climb.equilibrium import TorsoDynamics
from recon.robot.climb.fields import PLANAR, SPATIAL, Fields, Well
from recon.robot.climb.paths import Step
from recon.robot.climb.walker import LEGS

RECIPES = Path(__file__).parent / "recipes"
WELLS = ("radial", "swing", "flap")


@dataclass(frozen=True)
class Footfall:
    """leg: index into `LEGS`; the step it takes."""

    leg: int
    forward_m: float
    up_m: float
    sideways_m: float = 0.0

    @property
    def vector_m(self) -> Array:
        return np.array([self.sideways_m, self.forward_m, self.up_m])


@dataclass(frozen=True, eq=False)
class Primitive:
    """rise_rad, lower_rad: the angles of the feet's paths."""

    name: str
    footfalls: tuple[Footfall, ...]
    fields: Fields
    rise_rad: float
    lower_rad: float


@dataclass(frozen=True)
class Swing:
    """How a foot moves: its path's clearance above the higher end, and its speeds by phase."""

    clearance_m: float = 0.010
    rise_m_s: float = 0.2
    traverse_m_s: float = 0.3
    lower_m_s: float = 0.2


@dataclass(frozen=True, eq=False)
class Recipe:
    """robot: name of its description; stance_m (4, 2): where the feet stand at first, right and forward; made_by: the
    command that found the numbers."""

    robot: str
    step: Step
    stance_m: Array
    primitives: tuple[Primitive, ...]
    swing: Swing
    motion: TorsoDynamics
    fps: float
    made_by: str

    @property
    def footfalls(self) -> list[Footfall]:
        return [f for p in self.primitives for f in p.footfalls]


def bundled() -> list[str]:
    return sorted(p.stem for p in RECIPES.glob("*.toml"))


def load_recipe(recipe: str | Path) -> Recipe:
    """A bundled recipe by name, or a file. Raises InputError."""
    path = RECIPES / f"{recipe}.toml" if str(recipe) in bundled() else Path(recipe)
    table = read_toml(path, f"a recipe of a climb: a TOML file, or one of {', '.join(bundled())}")
    reader = _Reader(path)
    found = reader.recipe(table)
    if reader.problems or found is None:
        raise InputError(reader.problems)
    return found


LARGEST = 1e9
"""Of a number in a recipe: more can only be damage."""


class _Reader:
    """Collects every problem of a file."""

    def __init__(self, path: Path) -> None:
        self.path, self.problems = path, []

    def wrong(self, field: str, found: Any, expected: str) -> None:
        self.problems.append(Problem(self.path, field, repr(found), expected))

    def numbers(self, table: Any, names: Sequence[str], where: str, positive: bool = False) -> dict[str, float]:
        """The numbers of these names, 1 for those that are missing or wrong."""
        table = table if isinstance(table, Mapping) else {}
        found = {}
        for name in names:
            value = table.get(name)
            fine = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST
            if not fine or (positive and not value > 0):
                self.wrong(f"{where}.{name}", value, "a positive number" if positive else "a number")
                value = 1.0
            found[name] = float(value)  # pyright: ignore[reportArgumentType]
        for name in set(table) - set(names):
            self.wrong(f"{where}.{name}", table[name], f"one of {', '.join(names)}")
        return found

    def well(self, table: Any, where: str) -> Well:
        """Numbers for all legs, or pairs: for the front and for the rear legs."""
        table = table if isinstance(table, Mapping) else {}
        names = [f.name for f in fields(Well)]
        pairs = {n for n in names if isinstance(table.get(n), list) and len(table[n]) == 2}
        front, rear = (
            self.numbers({n: x[k] if n in pairs else x for n, x in table.items()}, names, where) for k in (0, 1)
        )
        for n in (front, rear):
            for name in ("gain", "low", "high"):
                if not n[name] > 0:
                    self.wrong(f"{where}.{name}", n[name], "a positive number")
            if not n["least"] <= n["natural"] <= n["most"]:
                self.wrong(where, (n["least"], n["natural"], n["most"]), "least <= natural <= most")
        values = {n: np.array([front[n], rear[n]] * 2) if n in pairs else front[n] for n in names}
        return Well(**values)  # pyright: ignore[reportArgumentType]

    def fields(self, table: Any, where: str) -> Fields:
        table = table if isinstance(table, Mapping) else {}
        balance = self.numbers(table.get("balance"), ("gain", "sharpness"), f"{where}.balance", positive=True)
        wells = {name: self.well(table.get(name), f"{where}.{name}") for name in WELLS}
        return Fields(**wells, balance_gain=balance["gain"], balance_sharpness=balance["sharpness"])

    def footfall(self, row: Any, where: str) -> Footfall:
        n = self.numbers(row, ("leg", "forward_m", "up_m", "sideways_m"), where)
        if n["leg"] not in (1, 2, 3, 4):
            self.wrong(f"{where}.leg", n["leg"], "1 to 4: " + ", ".join(LEGS))
        return Footfall(int(n["leg"]) - 1, n["forward_m"], n["up_m"], n["sideways_m"])

    def primitive(self, table: Any, where: str) -> Primitive:
        table = table if isinstance(table, Mapping) else {}
        name, falls = table.get("name"), table.get("footfalls")
        if not isinstance(name, str):
            self.wrong(f"{where}.name", name, "a name")
        if not isinstance(falls, list) or not falls:
            self.wrong(f"{where}.footfalls", falls, "a list of footfalls")
            falls = []
        read = tuple(self.footfall(row, f"{where}.footfalls[{k}]") for k, row in enumerate(falls))
        angles = {n: table.get(n) for n in ("rise_rad", "lower_rad")}
        angles = self.numbers(angles, tuple(angles), where, positive=True)
        return Primitive(str(name), read, self.fields(table.get("fields"), f"{where}.fields"), **angles)

    def recipe(self, table: Mapping[str, Any]) -> Recipe | None:
        step = self.numbers(table.get("step"), ("edge_m", "height_m"), "step")
        swing = self.numbers(table.get("swing"), [f.name for f in fields(Swing)], "swing", positive=True)
        names = ("mass", "inertia", "max_step_m", "max_turn_rad")
        motion = self.numbers(table.get("motion"), names, "motion", positive=True)
        top = self.numbers({"fps": table.get("fps")}, ("fps",), "recipe", positive=True)
        try:
            stance = np.array(table.get("stance_m"), float)
        except (TypeError, ValueError):
            stance = np.zeros(0)
        if stance.shape != (4, 2) or not np.isfinite(stance).all():
            self.wrong("stance_m", table.get("stance_m"), "four pairs: right and forward, by leg")
        for name in ("robot", "made_by"):
            if not isinstance(table.get(name), str):
                self.wrong(name, table.get(name), "text")
        dofs = table.get("dofs")
        if dofs not in (4, 6):
            self.wrong("dofs", dofs, "4 or 6")
        listed = table.get("primitives")
        if not isinstance(listed, list) or not listed:
            self.wrong("primitives", listed, "a list of primitives")
            listed = []
        primitives = tuple(self.primitive(p, f"primitives[{k}]") for k, p in enumerate(listed))
        if self.problems:
            return None
        return Recipe(
            str(table["robot"]),
            Step(**step),
            stance,
            primitives,
            Swing(**swing),
            TorsoDynamics(**motion, dofs=PLANAR if dofs == 4 else SPATIAL),
            top["fps"],
            str(table["made_by"]),
        )


def save_recipe(recipe: Recipe, path: str | Path) -> None:
    """Written whole or not at all; numbers to seven digits."""
    path = Path(path)
    table = {
        "robot": recipe.robot,
        "made_by": recipe.made_by,
        "dofs": len(recipe.motion.dofs),
        "fps": recipe.fps,
        "stance_m": [[_short(x) for x in row] for row in recipe.stance_m],
        "step": _table(recipe.step),
        "swing": _table(recipe.swing),
        "motion": {n: _short(getattr(recipe.motion, n)) for n in ("mass", "inertia", "max_step_m", "max_turn_rad")},
        "primitives": [
            {
                "name": p.name,
                "rise_rad": _short(p.rise_rad),
                "lower_rad": _short(p.lower_rad),
                "footfalls": [{**_table(f), "leg": f.leg + 1} for f in p.footfalls],
                "fields": {
                    **{name: _table(getattr(p.fields, name)) for name in WELLS},
                    "balance": {
                        "gain": _short(p.fields.balance_gain),
                        "sharpness": _short(p.fields.balance_sharpness),
                    },
                },
            }
            for p in recipe.primitives
        ],
    }
    with staged_file(path) as staged:
        staged.write_text(tomli_w.dumps(table), encoding="utf-8")


def _table(of: Any) -> dict[str, Any]:
    return {f.name: _short(getattr(of, f.name)) for f in fields(of)}


def _short(x: Any) -> Any:
    """A number, or the pair of the front and the rear legs', to seven digits."""
    values = [float(f"{float(v):.7g}") for v in np.ravel(x)]
    return values[:2] if len(values) == 4 else values[0]
