"""Mistakes in what a clip was given: sides exchanged, a picture turned over, another camera's, a wrong frame rate.

Each is recognised by how much likelier the clip is with the mistake undone (`likelihood`), where that can be told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from recon.animal.body import Body
from recon.animal.prior import NONE, MotionPrior, mean_speed_m_s
from recon.check.mistakes.likelihood import Given, given_of
from recon.check.mistakes.mend import with_sides_mended, without_garbage
from recon.check.mistakes.picture import of_other_camera, of_smaller_video, of_unit_square, turned_over
from recon.check.mistakes.rate import other_rate
from recon.check.mistakes.sides import exchanges
from recon.fit import TrajectoryOptions, TrajectorySolution
from recon.fit.mistake import Mistake, MistakeKind
from recon.fit.setting import Setting
from recon.geometry.camera import Camera
from recon.geometry.kinematics import ROOT

__all__ = [
    "FASTEST_M_S",
    "FLAGS",
    "GARBAGE",
    "SIDES",
    "Known",
    "Mistake",
    "MistakeKind",
    "find_mistakes",
    "with_flags",
    "with_sides_mended",
    "without_garbage",
]

SIDES, GARBAGE = "sides exchanged", "garbage"
FLAGS: dict[str, str] = {"sides": SIDES, "garbage": GARBAGE}
"""Flags of frames, by the kind of mistake in one camera's detections."""
FASTEST_M_S = 40.0
"""No animal runs as fast: cheetahs reach 29 m/s (N. Sharp, *Timed running speed of a cheetah*, J. Zool. 1997)."""


@dataclass(frozen=True)
class Known:
    """What is known besides: by view, other cameras that it might be of, none where its file's name says which it is,
    and the one that the name says instead; the frame rate that a file states, where another was given; and whether
    exchanged sides are looked for, which takes longest."""

    others: tuple[tuple[Camera, ...], ...]
    named: tuple[str | None, ...]
    stated_hz: float | None = None
    sides: bool = True


def find_mistakes(
    solution: TrajectorySolution,
    body: Body,
    prior: MotionPrior,
    fps: float,
    options: TrajectoryOptions,
    known: Known,
) -> tuple[Mistake, ...]:
    """In the keypoints that a solution was fitted to. Each angle on its own, where no prior was learned, tells neither
    sides nor rates."""
    setting = Setting.of(solution.views, body, prior, fps, options)
    weighed = replace(setting, trust=min((spell.prior_weight for spell in solution.spells), default=1.0))
    too_fast = mean_speed_m_s(solution.states, fps) > FASTEST_M_S  # nor does the prior know it
    unlike = too_fast or any(spell.unlike_prior for spell in solution.spells)
    sides = known.sides and prior.name != NONE and bool(solution.posed.any())
    found: list[Mistake] = []
    with threadpool_limits(1, user_api="blas"):
        for number in range(len(setting.views)):
            given = given_of(setting, number, solution.states, solution.size)
            of_picture = _of_picture(given, number, known)
            if of_picture is not None:
                found.append(of_picture)
            elif sides:
                if weighed.trust < 1:
                    given = given_of(weighed, number, solution.states, solution.size)
                found += exchanges(given, number, unlike)
        if not any(one.kind == "normalised" for one in found):
            found += _of_rate(setting, solution, known.stated_hz)
    return tuple(found)


def _of_picture(given: Given, number: int, known: Known) -> Mistake | None:
    """The first of those that leave nothing else to be told."""
    return (
        of_unit_square(given, number)
        or turned_over(given, number)
        or of_smaller_video(given, number)
        or of_other_camera(given, number, known.others[number], known.named[number])
    )


def _of_rate(setting: Setting, solution: TrajectorySolution, stated_hz: float | None) -> Sequence[Mistake]:
    posed = np.isfinite(solution.states[:, 0])
    spells = [spell.rows for spell in solution.spells if posed[spell.rows].all()]
    if not spells:
        return ()
    longest = max(spells, key=lambda rows: rows.stop - rows.start)
    states = solution.states[longest].copy()
    states[:, ROOT] = (states[:, ROOT] - setting.origin_m) / solution.size
    found = other_rate(setting.part(longest), states, stated_hz)
    return () if found is None else (found,)


def with_flags(solution: TrajectorySolution, mistakes: Sequence[Mistake]) -> TrajectorySolution:
    """With those of the frames that mistakes are about and that were not mended."""
    flags = [*solution.flags]
    for one in mistakes:
        name = FLAGS.get(one.kind)
        if name is not None and one.rows is not None and not one.mended:
            for t in range(*one.rows):
                flags[t] = flags[t] if name in flags[t] else (*flags[t], name)
    return replace(solution, flags=tuple(flags))
