"""Which files are one clip that several cameras filmed: by the cameras' names in theirs, or by a pattern."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from recon.base.errors import InputError, Problem, refuse
from recon.check import names_text
from recon.workflows.cameras import cameras_in

AUTO, NONE = "auto", "none"
OPTION = "--cameras-by"
SEPARATORS = "-_. "


@dataclass(frozen=True)
class ClipDraft:
    """A clip without a name of its own."""

    paths: tuple[Path, ...]
    """Its files."""
    row: Mapping[str, Any] = field(default_factory=dict)
    """The settings that it has of its own."""
    name: str | None = None
    where: tuple[Path, str] | None = None
    """Where a manifest says so."""
    called: Path | None = None
    """What it is named after, where that is not its only file."""
    cam_regex: tuple[Path, str] | None = None
    """Anipose's, with the file that has it."""
    joined: bool = False
    """Whether its files were brought together by their names."""

    @property
    def title(self) -> Path:
        return self.called or self.paths[0]

    @property
    def tag(self) -> str:
        """What tells clips of one file apart: the animal and the frames."""
        parts = [str(self.row[key]).replace(":", "-") for key in ("individual", "frames") if key in self.row]
        return "".join(f"-{part}" for part in parts)


@dataclass(frozen=True)
class _Named:
    """What a file's name says."""

    draft: ClipDraft
    camera: str
    title: Path
    """The clip without its camera."""
    by: str
    """Whose rule that is, for a note."""


def join_cameras(
    drafts: Sequence[ClipDraft],
    cameras_by: str,
    camera_name: str | Sequence[str] | None,
    cameras_of: Callable[[ClipDraft], Sequence[str]],
) -> tuple[list[ClipDraft], list[str]]:
    """The files of one clip in one draft, in the order of the drafts, and notes. camera_name: as given for every clip.

    cameras_by: a pattern; `AUTO`: Anipose's pattern, or the names of a draft's cameras, as `cameras_of` gives them, if
    any two files are one clip by them; `NONE`: nothing is joined. Files of one folder are one clip if their names are
    the same without what the pattern fits, or without the camera's name. A manifest's rows are never joined. Raises
    InputError for a faulty pattern, one that fits no file, and two files of one camera in a clip.
    """
    pattern = None if cameras_by in (AUTO, NONE) else _compiled_pattern(cameras_by, OPTION)
    if pattern is not None and camera_name is not None:
        found = f"{camera_name if isinstance(camera_name, str) else ', '.join(camera_name)} beside {OPTION}"
        raise InputError(Problem("--camera-name", "camera_name", found, "one of the two"))
    read: list[ClipDraft | _Named] = []
    left_out: list[Path] = []
    for draft in drafts:
        if draft.where is not None:
            read.append(_draft_of_row(draft, pattern, cameras_of))
            continue
        named = _named(draft, pattern, cameras_by, cameras_of)
        if named is None and (pattern or draft.cam_regex):
            left_out.append(draft.paths[0])
        else:
            read.append(named or draft)
    if left_out and not any(isinstance(one, _Named) for one in read):
        raise InputError(
            Problem(OPTION, "pattern", f"no camera in {_file_names_text(left_out)}", "one that fits the files' names")
        )
    notes = [f"Left out, without a camera in the name: {_file_names_text(left_out)}"] if left_out else []
    groups: dict[Any, list[_Named]] = {}
    for one in read:
        if isinstance(one, _Named):
            groups.setdefault(_clip_key(one, cameras_by), []).append(one)
    several = any(len(group) > 1 for group in groups.values())
    joined, problems = [], []
    for one in read:
        if isinstance(one, ClipDraft):
            joined.append(one)
        elif one.by == AUTO and not several:
            joined.append(one.draft)
        elif groups[_clip_key(one, cameras_by)][0] is one:
            group = groups[_clip_key(one, cameras_by)]
            problems += _repeated_cameras(group)
            joined.append(_clip_draft(group, cameras_by))
    refuse(problems)
    if several:
        notes.append(_joined_text([group for group in groups.values() if len(group) > 1]))
    return joined, notes


def missing_cameras(drafts: Sequence[ClipDraft], names: Sequence[str]) -> list[str]:
    """A note of the joined clips, by name, that do not have all the cameras that others have."""
    joined = [(draft, name) for draft, name in zip(drafts, names, strict=True) if draft.joined]
    every: dict[Any, dict[str, None]] = {}  # by project, whose cameras have names of their own
    for draft, _ in joined:
        every.setdefault(draft.cam_regex, {}).update(dict.fromkeys(draft.row["camera_name"]))
    lacks = []
    for draft, name in joined:
        missing = [one for one in every[draft.cam_regex] if one not in draft.row["camera_name"]]
        if missing:
            lacks.append(f"{name} ({', '.join(missing)})")
    return [f"Fitted without cameras that others have: {names_text(lacks)}"] if lacks else []


def _compiled_pattern(text: str, where: Path | str) -> re.Pattern[str]:
    try:
        return re.compile(text)
    except re.error as error:
        expected = "a regular expression that finds the camera's name in a file's name, as in '-cam([A-Z])'"
        raise InputError(Problem(where, "pattern", f"{text!r} ({error})", expected)) from None


def _named(
    draft: ClipDraft, pattern: re.Pattern[str] | None, cameras_by: str, cameras_of: Callable[[ClipDraft], Sequence[str]]
) -> _Named | None:
    if pattern is not None:
        return _by_pattern(draft, pattern, OPTION)
    if draft.cam_regex is not None:
        config, text = draft.cam_regex
        return _by_pattern(draft, _compiled_pattern(text, config), f"cam_regex in {config}")
    return None if cameras_by == NONE else _by_names(draft, draft.title, cameras_of(draft))


def _by_pattern(draft: ClipDraft, pattern: re.Pattern[str], by: str, path: Path | None = None) -> _Named | None:
    """The pattern's first group is the camera's name, or all of it, as in Anipose."""
    title = path or draft.title
    match = pattern.search(title.stem)
    camera = "" if match is None else (match[1] if pattern.groups else match[0]) or ""
    return None if match is None or not camera.strip() else _Named(draft, camera.strip(), _clip_title(title, match), by)


def _by_names(draft: ClipDraft, title: Path, cameras: Sequence[str]) -> _Named | None:
    found = cameras_in(title.stem, cameras)
    if len(found) > 1:
        names = " and ".join(found)
        expected = f"the name of one camera; {OPTION} with a pattern that finds it, or {OPTION} {NONE}"
        raise InputError(Problem(title, "name", f"the cameras {names}", expected))
    return next((_Named(draft, camera, _clip_title(title, match), AUTO) for camera, match in found.items()), None)


def _clip_title(title: Path, match: re.Match[str]) -> Path:
    """What a clip is called: its files without their cameras' names, or, if that is nothing, their folder."""
    rest = (title.stem[: match.start()].rstrip(SEPARATORS) + title.stem[match.end() :]).strip(SEPARATORS)
    folder = title.parent
    return folder / f"{rest}{title.suffix}" if rest else folder.parent / f"{folder.name}{title.suffix}"


def _clip_key(one: _Named, cameras_by: str) -> Any:
    """What the files of one clip have in common."""
    if cameras_by == NONE:
        return one.draft.paths
    return one.draft.title.parent, one.title.name.casefold(), repr(one.draft.row)


def _clip_draft(group: Sequence[_Named], cameras_by: str) -> ClipDraft:
    first = group[0]
    cameras = tuple(one.camera for one in group)
    return replace(
        first.draft,
        paths=tuple(one.draft.paths[0] for one in group),
        row={**first.draft.row, "camera_name": cameras},
        called=first.draft.title if cameras_by == NONE else first.title,
        joined=cameras_by != NONE,
    )


def _draft_of_row(
    draft: ClipDraft, pattern: re.Pattern[str] | None, cameras_of: Callable[[ClipDraft], Sequence[str]]
) -> ClipDraft:
    """A manifest's row with the cameras that the pattern finds, called after what its files have in common."""
    if pattern is not None:
        named = [_by_pattern(draft, pattern, OPTION, path) for path in draft.paths]
    elif len(draft.paths) > 1:
        names = draft.row.get("camera_name") or cameras_of(draft)
        named = [_by_names(draft, path, names) for path in draft.paths]
    else:
        return draft
    found = [one for one in named if one is not None]
    if len(found) < len(named):
        return draft
    titles = dict.fromkeys(one.title for one in found)
    row = {"camera_name": tuple(one.camera for one in found), **draft.row}
    return replace(draft, row=row, called=next(iter(titles)) if len(draft.paths) > 1 == len(titles) else None)


def _repeated_cameras(group: Sequence[_Named]) -> list[Problem]:
    first: dict[str, Path] = {}
    problems = []
    for one in group:
        path = one.draft.paths[0]
        if one.camera in first:
            found = f"{one.camera}, and so has {first[one.camera].name}"
            expected = f"one file for each camera of a clip; {OPTION} with another pattern, or {OPTION} {NONE}"
            problems.append(Problem(path, "camera", found, expected))
        first.setdefault(one.camera, path)
    return problems


def _joined_text(groups: Sequence[Sequence[_Named]]) -> str:
    files, rules = sum(map(len, groups)), dict.fromkeys(one.by for group in groups for one in group)
    by = " and ".join("the cameras' names in theirs" if rule == AUTO else rule for rule in rules)
    clips = f"{len(groups)} clips" if len(groups) > 1 else "1 clip"
    otherwise = f" ({OPTION} {NONE} takes each by itself)" if OPTION not in rules else ""
    return f"{files} files are {clips} of several cameras, by {by}{otherwise}."


def _file_names_text(paths: Sequence[Path]) -> str:
    return names_text([path.name for path in paths])
