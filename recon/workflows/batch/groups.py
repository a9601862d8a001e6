"""Which files are one clip that several cameras filmed: by the cameras' names in theirs, or by a pattern."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from recon.base.errors import InputError, Problem
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
    by: str | None = None
    """Whose rule found the camera in its files' names."""

    @property
    def title(self) -> Path:
        return self.called or self.paths[0]

    @property
    def tag(self) -> str:
        """What tells clips of one file apart: the animal and the frames."""
        parts = [str(self.row[key]).replace(":", "-") for key in ("individual", "frames") if key in self.row]
        return "".join(f"-{part}" for part in parts)


def join_cameras(
    drafts: Sequence[ClipDraft],
    cameras_by: str,
    camera_name: str | Sequence[str] | None,
    cameras_of: Callable[[ClipDraft], Sequence[str]],
) -> tuple[list[ClipDraft], list[str]]:
    """The files of one clip in one draft, in the order of the drafts, and notes. camera_name: as given for every clip.

    cameras_by: a pattern; `AUTO`: Anipose's pattern, or the names of a draft's cameras, as `cameras_of` gives them, if
    any two files are one clip by them; `NONE`: nothing is joined. Files of one folder are one clip if their names are
    the same without what the pattern fits, or without the camera's name. A manifest's rows say themselves which files
    they have. Raises InputError for a faulty pattern, and one that fits no file.
    """
    pattern = None if cameras_by in (AUTO, NONE) else _compiled(cameras_by, OPTION)
    if pattern is not None and camera_name is not None:
        found = f"{camera_name if isinstance(camera_name, str) else ', '.join(camera_name)} beside {OPTION}"
        raise InputError(Problem("--camera-name", "camera_name", found, "one of the two"))
    read = [_with_camera(draft, pattern, cameras_by, cameras_of) for draft in drafts]

    def is_lost(one: ClipDraft) -> bool:
        return one.by is None and one.where is None and bool(pattern or one.cam_regex)

    lost = [one for one in read if is_lost(one)]
    left_out = names_text([one.paths[0].name for one in lost])
    if lost and not any(one.by for one in read):
        raise InputError(Problem(OPTION, "pattern", f"no camera in {left_out}", "one that fits the files' names"))
    groups: dict[Any, list[tuple[ClipDraft, ClipDraft]]] = {}  # as it was, and with its camera
    for draft, one in zip(drafts, read, strict=True):
        if not is_lost(one):
            row = {name: value for name, value in one.row.items() if name != "camera_name"}
            clip = one.title.parent, one.title.name.casefold(), repr(row)
            alone = one.by is None or cameras_by == NONE
            groups.setdefault(len(groups) if alone else clip, []).append((draft, one))
    several = [[one for _, one in group] for group in groups.values() if len(group) > 1]
    joined = []
    for (draft, one), *others in groups.values():
        cameras = tuple(name for _, each in ((draft, one), *others) for name in each.row.get("camera_name", ()))
        if one.by is None or (one.by == AUTO and not several):
            joined.append(draft)
        else:
            paths = one.paths + tuple(path for _, each in others for path in each.paths)
            joined.append(replace(one, paths=paths, row={**one.row, "camera_name": cameras}))
    notes = [f"Left out, without a camera in the name: {left_out}"] if lost else []
    return joined, notes + ([_joined_text(several)] if several else [])


def missing_cameras(drafts: Sequence[ClipDraft], names: Sequence[str]) -> list[str]:
    """A note of the joined clips, by name, that do not have all the cameras that others have."""
    every: dict[Any, dict[str, None]] = {}  # by project, whose cameras have names of their own
    for draft in drafts:
        if draft.by:
            every.setdefault(draft.cam_regex, {}).update(dict.fromkeys(draft.row["camera_name"]))
    lacks = []
    for draft, name in zip(drafts, names, strict=True):
        missing = [one for one in every[draft.cam_regex] if one not in draft.row["camera_name"]] if draft.by else []
        if missing:
            lacks.append(f"{name} ({', '.join(missing)})")
    return [f"Fitted without cameras that others have: {names_text(lacks)}"] if lacks else []


def _compiled(text: str, where: Path | str) -> re.Pattern[str]:
    try:
        return re.compile(text)
    except re.error as error:
        expected = "a regular expression that finds the camera's name in a file's name, as in '-cam([A-Z])'"
        raise InputError(Problem(where, "pattern", f"{text!r} ({error})", expected)) from None


def _with_camera(
    draft: ClipDraft, pattern: re.Pattern[str] | None, cameras_by: str, cameras_of: Callable[[ClipDraft], Sequence[str]]
) -> ClipDraft:
    """With the camera that its file's name says, and called after what is left of the name; as it is where that says
    none, or a manifest has it."""
    if draft.where is not None:
        return draft
    title, by = draft.title, OPTION
    if pattern is None and draft.cam_regex is not None:
        pattern, by = _compiled(draft.cam_regex[1], draft.cam_regex[0]), f"cam_regex in {draft.cam_regex[0]}"
    if pattern is not None:  # its first group is the camera's name, or all of it, as in Anipose
        match = pattern.search(title.stem)
        found = {} if match is None else {((match[1] if pattern.groups else match[0]) or "").strip(): match}
    else:
        by, found = AUTO, {} if cameras_by == NONE else cameras_in(title.stem, cameras_of(draft))
    if len(found) > 1:
        expected = f"the name of one camera; {OPTION} with a pattern that finds it, or {OPTION} {NONE}"
        raise InputError(Problem(title, "name", f"the cameras {' and '.join(found)}", expected))
    for camera, match in found.items():
        if camera:
            called = title if cameras_by == NONE else _clip_title(title, match)
            return replace(draft, row={**draft.row, "camera_name": (camera,)}, called=called, by=by)
    return draft


def _clip_title(title: Path, match: re.Match[str]) -> Path:
    """What a clip is called: its files without their cameras' names, or, if that is nothing, their folder."""
    rest = (title.stem[: match.start()].rstrip(SEPARATORS) + title.stem[match.end() :]).strip(SEPARATORS)
    folder = title.parent
    return folder / f"{rest}{title.suffix}" if rest else folder.parent / f"{folder.name}{title.suffix}"


def _joined_text(groups: Sequence[Sequence[ClipDraft]]) -> str:
    files, rules = sum(map(len, groups)), dict.fromkeys(one.by for group in groups for one in group)
    by = " and ".join("the cameras' names in theirs" if rule == AUTO else str(rule) for rule in rules)
    clips = f"{len(groups)} clips" if len(groups) > 1 else "1 clip"
    otherwise = f" ({OPTION} {NONE} takes each by itself)" if OPTION not in rules else ""
    return f"{files} files are {clips} of several cameras, by {by}{otherwise}."
