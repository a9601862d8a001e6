"""Skeletons by their names or files (TOML), with one animal's lengths, and as a detector sees them.

Built-in skeletons are the files of `recon/animal/skeletons`, built-in subjects (one animal's lengths) those of
`recon/animal/subjects`. A network marks what its labellers took for a joint, on the skin and each in their own way; a
model's markers lie where its bones meet: how far apart they are says a file of `recon/animal/detectors` for each
detector and skeleton, which `recon subject fit --offsets --no-lengths` makes. Which detector a keypoint file is of, its
scorer says.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from recon.animal.body import Body, other_side, side_of
from recon.animal.body_file import FileTable, Number, Sigma, load_body, read_named, unknown
from recon.base import documents
from recon.base.documents import validated
from recon.base.errors import InputError, Problem, refuse

if TYPE_CHECKING:
    from recon.animal.chain import Chain


def builtin_names() -> tuple[str, ...]:
    """Names of the skeletons that come with the package."""
    return documents.builtin_names("animal/skeletons", ".toml")


def skeleton_of(keypoints: Iterable[str]) -> str | None:
    """The built-in skeleton of a whole animal whose markers, all of them, are called as some of these keypoints; of
    several the one with most."""
    names, chains = {*keypoints}, builtin_chains()
    markers = {name: {*load_skeleton(name).markers} for name in builtin_names() if name not in chains}
    fitting = [name for name, own in markers.items() if own <= names]
    return max(fitting, key=lambda name: len(markers[name]), default=None)


def builtin_chains() -> tuple[str, ...]:
    """The names of the built-in skeletons that are chains, for the frame method."""
    return tuple(name for name in builtin_names() if "segments" not in read_named(name)[0])


def builtin_subjects() -> tuple[str, ...]:
    """Names of the subjects that come with the package."""
    return documents.builtin_names("animal/subjects", ".toml")


def load_skeleton(name_or_path: str | Path, subject: str | Path | None = None) -> Body:
    """The built-in skeleton of that name, or the one in a TOML file.

    subject: name or file of a measured animal, for a whole one only. Raises InputError: no such name or file, a file
    that does not describe a skeleton, or a subject of another one; every problem is named.
    """
    raw, source = read_named(name_or_path)
    if "segments" in raw:
        return load_body(raw, source, subject)
    if subject is not None:
        expected = f"none: {source} is a chain, and a measured chain is a skeleton of its own"
        raise InputError(Problem("--subject", "name or file", repr(str(subject)), expected))
    from recon.animal.chain import chain_of  # hardly any clip is of one

    return chain_of(raw, source).body


def load_chain(name_or_path: str | Path) -> Chain:
    """The chain that a skeleton is, for the frame method. Raises InputError for a whole animal, too."""
    raw, source = read_named(name_or_path, suggested=builtin_chains)
    if "segments" in raw:
        expected = f"a chain for the frame method: one of {', '.join(builtin_chains())}, or a file with [[links]]"
        raise InputError(Problem("--skeleton", "name or file", repr(str(name_or_path)), expected))
    from recon.animal.chain import chain_of

    return chain_of(raw, source)


# -- detectors --------------------------------------------------------------------------------------------------------

NONE = "none"
"""The detector whose keypoints lie on the markers."""
OWN = "own"
"""The name of the detector where a skeleton's or a subject's own file says where its keypoints lie."""


class _Keypoint(FileTable):
    offset_m: tuple[Number, Number, Number]
    spread_m: Sigma
    sigma_m: Sigma | None = None


class _DetectorFile(FileTable):
    skeleton: str
    title: str
    scorers: tuple[str, ...] = ()
    keypoint_sigma_m: Sigma
    keypoints: Annotated[dict[str, _Keypoint], Field(min_length=1)]


def of_scorer(scorer: str | None, skeleton: str) -> str:
    """The built-in detector that writes that scorer into its files, for a skeleton; "none" where there is none."""
    for name in documents.builtin_names("animal/detectors", ".toml") if scorer else ():
        raw, _ = read_named(name, "detector")
        if raw["skeleton"] == skeleton and any(fnmatchcase(scorer or "", one) for one in raw.get("scorers", ())):
            return name
    return NONE


def seen_by(body: Body, detector: str | Path | None, scorers: Mapping[str, str | None] | None = None) -> Body:
    """The body as a detector sees it, by name, file or "none"; by default as the animal's or the skeleton's file says,
    and where they say nothing as the scorers of the keypoint files do, by file. Without scorers it is not known then.

    Markers of the right side follow those of the left, mirrored, unless the file has both. Raises InputError for a file
    that does not fit the body, and for scorers of two detectors.
    """
    if detector is None and body.keypoint_offset_m:
        return replace(body, detector=OWN)
    detector = body.detector if detector is None else detector
    if detector is None and scorers:
        detector = _of_scorers(scorers, body.name)
    if detector is None:
        return body
    if str(detector) == NONE:
        return replace(body, detector=NONE, keypoint_offset_m={}, keypoint_spread_m={}, keypoint_noise_m={})
    raw, source = read_named(detector, "detector")
    file = validated(_DetectorFile, raw, source)
    if file.skeleton != body.name:
        raise InputError(Problem(source, "skeleton", repr(file.skeleton), f"{body.name}, the skeleton of the fit"))
    refuse(unknown(source, [(f"keypoints.{marker}", marker) for marker in file.keypoints], body.markers))
    offset_m, spread_m, noise_m = {}, {}, {}
    for marker in body.markers:
        follows = marker not in file.keypoints and side_of(marker) == "right"
        found = file.keypoints.get(other_side(marker) if follows else marker)
        if found is not None:
            x, y, z = found.offset_m
            offset_m[marker], spread_m[marker] = (x, -y if follows else y, z), found.spread_m
            noise_m |= {marker: found.sigma_m} if found.sigma_m is not None else {}
    return replace(
        body,
        detector=str(detector),
        keypoint_sigma_m=file.keypoint_sigma_m,
        keypoint_offset_m=offset_m,
        keypoint_spread_m=spread_m,
        keypoint_noise_m=noise_m,
    )


def _of_scorers(scorers: Mapping[str, str | None], skeleton: str) -> str:
    found = {file: of_scorer(scorer, skeleton) for file, scorer in scorers.items()}
    if len({*found.values()}) > 1:
        each = (f"{Path(file).name} of {of} (scorer {str(scorers[file])[:60]!r})" for file, of in found.items())
        expected = f"files of one detector, or the one to take for all cameras: --set detector={NONE}, or its name"
        raise InputError(Problem("KEYPOINTS", "detector", ", ".join(each), expected))
    return next(iter(found.values()))


def detector_toml(body: Body, title: str, notes: Sequence[str] = ()) -> str:
    """The text of a detector file, as a body is seen, of the left side and the middle. notes: comments."""
    import tomli_w

    keypoints = {
        marker: {
            "offset_m": [round(x, 4) for x in body.keypoint_offset_m[marker]],
            "spread_m": round(spread, 4),
            "sigma_m": round(body.keypoint_noise_m.get(marker, body.keypoint_sigma_m), 4),
        }
        for marker, spread in body.keypoint_spread_m.items()
        if marker in body.keypoint_offset_m and (side_of(marker) != "right" or other_side(marker) not in body.markers)
    }
    plain = {"skeleton": body.name, "title": title, "keypoint_sigma_m": round(body.keypoint_sigma_m, 4)}
    return "".join(f"# {note}\n" for note in notes) + tomli_w.dumps(plain | {"keypoints": keypoints})
