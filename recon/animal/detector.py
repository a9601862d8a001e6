"""Where a detector's keypoints lie beside the markers of a skeleton: one TOML file for each detector and skeleton.

A network marks what its labellers took for a joint, on the skin and each in their own way; a model's markers lie where
its bones meet. Built-in detectors are the files of `recon/animal/detectors`; `recon subject fit --offsets --no-lengths`
makes one. Which one a keypoint file is of, its scorer says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

from pydantic import Field

from recon.animal.body import Body, other_side, side_of
from recon.animal.skeleton_file import FileTable, Number, Sigma, read_named, unknown
from recon.base import package
from recon.base.documents import validated
from recon.base.errors import InputError, Problem, refuse

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
    for name in package.builtin_names("animal/detectors", ".toml") if scorer else ():
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
