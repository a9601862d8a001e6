"""What is wrong with a batch's inputs, as far as it can be told without fitting: the checks of the fit itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from recon.base.errors import InputError, Problem
from recon.workflows.batch.inputs import Clip
from recon.workflows.clip import Shared, prepare, read_model_and_cameras
from recon.workflows.settings import FitSettings

Problems = tuple[Problem, ...]


def input_problems(clips: Sequence[Clip]) -> list[Problems]:
    """Of each clip: everything that its fit would raise before solving."""
    read_shared = _Shared()
    return [_problems_of(lambda s=clip.settings: prepare(s, read_shared)) for clip in clips]


def check_shared(clips: Sequence[Clip]) -> None:
    """Raises InputError for problems with cameras, skeletons, subjects and priors that every clip has, be it each with
    a file of its own."""
    read_shared = _Shared()
    each = [_problems_of(lambda s=clip.settings: read_shared(s)) for clip in clips]
    same = set.intersection(*({_without_file(problem) for problem in problems} for problems in each)) if each else set()
    if same:
        first = [problem for problem in each[0] if _without_file(problem) in same]
        raise InputError(dict.fromkeys(_of_all_files(problem, each) for problem in first))


def repeated(each: Sequence[Problems]) -> list[tuple[Problem, tuple[int, ...]]]:
    """What several clips have in common is said once, whatever the files are called: each problem, as it was found
    first, and the places among all clips of those that have the same."""
    found: dict[tuple[str, str, str], list[int]] = {}
    first: dict[tuple[str, str, str], Problem] = {}
    for place, problems in enumerate(each):
        for problem in problems:
            first.setdefault(_without_file(problem), problem)
            found.setdefault(_without_file(problem), []).append(place)
    return [(first[what], tuple(dict.fromkeys(places))) for what, places in found.items()]


def _without_file(problem: Problem) -> tuple[str, str, str]:
    return problem.field, problem.found, problem.expected


def _of_all_files(problem: Problem, each: Sequence[Problems]) -> Problem:
    files = {other.file for problems in each for other in problems if _without_file(other) == _without_file(problem)}
    return problem if len(files) == 1 else replace(problem, file=f"{problem.file} and {len(files) - 1} more files")


class _Shared:
    """`read_model_and_cameras` for many clips: what they share is read once."""

    def __init__(self) -> None:
        self._known: dict[FitSettings, Shared | InputError] = {}

    def __call__(self, settings: FitSettings) -> Shared:
        # Names of keypoint files choose cameras.
        names = tuple(
            Path(path.name if settings.camera_name is None else str(i)) for i, path in enumerate(settings.keypoints)
        )
        shared = replace(settings, keypoints=names, individual=None, frames=None)
        if shared not in self._known:
            try:
                self._known[shared] = read_model_and_cameras(shared)
            except InputError as error:
                self._known[shared] = error
        known = self._known[shared]
        if isinstance(known, InputError):
            raise InputError(known.problems)
        return known


def _problems_of(read: Callable[[], Any]) -> Problems:
    try:
        read()
    except InputError as error:
        return error.problems
    return ()
