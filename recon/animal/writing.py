"""The files of what was measured of animals, as they are written: subjects, detectors and priors."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from recon.animal.body import Body, other_side, side_of
from recon.animal.prior import SHAPES, MotionPrior
from recon.animal.skeleton_file import read_named
from recon.base.files import staged_file, write_bytes


def subject_toml(skeleton: str | Path, body: Body, title: str, notes: Sequence[str] = ()) -> str:
    """The text of a subject file: the lengths and keypoint offsets of a body, of that skeleton. notes: comments."""
    raw, _ = read_named(skeleton)
    placed = {item.name: item.offset_m for item in (*body.tree.segments, *body.tree.markers)}
    given = [item["name"] for item in (*raw["segments"][1:], *raw["markers"])]
    offsets = {marker["name"]: body.keypoint_offset_m.get(marker["name"]) for marker in raw["markers"]}
    plain = {
        "skeleton": raw["name"],
        "title": title,
        "size_sigma": round(body.size_sigma, 4),
        "at_m": {name: [round(x, 4) for x in placed[name]] for name in given if any(placed[name])},
        "keypoint_offset_m": {name: [round(x, 4) for x in at] for name, at in offsets.items() if at is not None},
    }
    return "".join(f"# {note}\n" for note in notes) + tomli_w.dumps(plain)


def detector_toml(body: Body, title: str, notes: Sequence[str] = ()) -> str:
    """The text of a detector file, as a body is seen, of the left side and the middle. notes: comments."""
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


def save_prior(prior: MotionPrior, path: str | Path) -> None:
    """Write an .npz: the arrays in single precision, the texts as JSON, no pickles."""
    about: dict[str, Any] = {"format": 1, "name": prior.name, "source": prior.source}
    about |= {"angles": list(prior.angles), "segments": [asdict(row) for row in prior.segments]}
    arrays = {name: getattr(prior, name).astype(np.float32) for name in SHAPES}
    made = io.BytesIO()
    np.savez_compressed(made, about=np.array(json.dumps(about)), **arrays)
    with staged_file(Path(path)) as staged:
        write_bytes(staged, made.getvalue())
