"""Advise on the positions of one or two cameras for measuring an angle or a joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from typing import Any

import numpy as np
import pandas as pd

from recon.animal.anatomy import joint_and_side, joints_named, suggested_joint
from recon.animal.body import Body
from recon.animal.prior import load_prior
from recon.animal.skeleton_file import load_skeleton
from recon.api.camera_settings import CameraAdviceSettings
from recon.base.errors import InputError, Problem
from recon.base.numbers import decimals, percent, quantity
from recon.base.outputs import Output
from recon.base.progress import Progress, silent
from recon.base.settings import input_paths
from recon.calibrate.camera_advice import AZIMUTHS_RAD, ELEVATIONS_RAD, PICTURE_PX, Advice, advise
from recon.fit.motion import MEASURED_FRACTION
from recon.io.writing import write_rows
from recon.show.plain import picked, to_json
from recon.show.plots.cameras import camera_advice as advice_figure
from recon.show.plots.cameras import in_words
from recon.show.plots.style import save

REPORT, TABLE, FIGURE = "camera_advice.json", "camera_advice.csv", "camera_advice"
DIRECTIONS = (
    *(
        "ahead of the animal",
        "ahead of the animal, to its left",
        "on the animal's left side",
        "behind the animal, to its left",
    ),
    *(
        "behind the animal",
        "behind the animal, to its right",
        "on the animal's right side",
        "ahead of the animal, to its right",
    ),
)
"""Words for directions from the animal in steps of 45°, counterclockwise seen from above, from straight ahead."""
HEIGHTS = ((np.radians(15), "level with its middle"), (np.radians(45), "raised"), (np.radians(70), "high up"))
"""Upper limits of the camera's elevation above the animal, rad, with the words for elevations below them."""
ABOVE = "almost above it"


def in_sentences(advice_by_camera: Sequence[Advice]) -> Iterator[str]:
    """Yield sentences on the best position of the camera, or of the first and the second camera."""
    for number, advice in enumerate(advice_by_camera, start=1):
        camera = "the camera" if len(advice_by_camera) == 1 else f"camera {number}"
        fraction, sigma = (float(values[advice.best]) for values in (advice.share, advice.sigma))
        yield (
            f"Put {camera} {direction_text(*advice.position)}, "
            f"{advice.distance_m * np.sin(advice.position[1]):.2g} m above its middle and "
            f"{advice.distance_m:{decimals(advice.distance_m)}} m away: {percent(fraction)} of the precision of "
            f"{advice.target} comes from the pixels, ±{in_words(sigma, advice.unit)}."
        )
    first = advice_by_camera[0]
    worst = np.unravel_index(int(np.argmax(first.sigma)), first.sigma.shape)
    position = AZIMUTHS_RAD[worst[1]], ELEVATIONS_RAD[worst[0]]
    sigma = float(first.sigma[worst])
    precision = f"±{in_words(sigma, first.unit)}" if np.isfinite(sigma) else "the animal is not in the picture"
    yield f"The worst position for one camera is {direction_text(*map(float, position))}: {precision}."
    if advice_by_camera[-1].share.max() < MEASURED_FRACTION:
        yield f"No position shows {first.target} well: more of the precision comes from the prior than from the pixels."


def direction_text(azimuth_rad: float, elevation_rad: float) -> str:
    """Return a direction from the animal in words, such as "on the animal's left side, raised (90°)"."""
    direction = DIRECTIONS[round(azimuth_rad / (np.pi / 4)) % 8]
    height = next((text for limit, text in HEIGHTS if elevation_rad < limit), ABOVE)
    azimuth = quantity(np.degrees(azimuth_rad), 0, "°")
    return f"{direction}, {height} ({azimuth})"


def run_camera_advice(settings: CameraAdviceSettings, progress: Progress = silent) -> dict[str, Any]:
    """Find the best positions for one or two cameras, write the figure and the table, and return the report.

    Raises
    ------
    InputError
        If settings cannot be used.
    """
    body = load_skeleton(settings.skeleton, settings.subject)
    target = _target(settings, body)
    motions = load_prior(settings.prior, body)
    output = Output(settings.out, "camera-advice", settings.overwrite, input_paths(settings), content="advice")
    output.require((REPORT, TABLE, f"{FIGURE}.png", f"{FIGURE}.svg"))
    setup = picked(settings, "hfov_deg", "distance_m", "cameras")
    advice_by_camera = advise(body, motions, target, **setup, progress=lambda share: progress("cameras", share))
    tables = [_position_table(number, advice) for number, advice in enumerate(advice_by_camera, start=1)]
    table = pd.concat(tables)
    best = [advice.best[0] * len(AZIMUTHS_RAD) + advice.best[1] for advice in advice_by_camera]
    report = {
        "schema": {"name": "recon.camera_advice", "version": 1},
        "skeleton": body.name,
        "prior": motions.name,
        "of": advice_by_camera[0].target,
        "hfov_deg": settings.hfov_deg,
        "image_size_px": PICTURE_PX,
        "distance_m": advice_by_camera[0].distance_m,
        "cameras": [
            camera_table.drop(columns="camera").iloc[row].to_dict()
            for camera_table, row in zip(tables, best, strict=True)
        ],
        "words": [*in_sentences(advice_by_camera)],
    }
    with output.staged() as staging:
        (staging / REPORT).write_text(to_json(report), encoding="utf-8")
        write_rows(staging / TABLE, [[*table.columns]], table.itertuples(index=False))
        save(advice_figure(advice_by_camera), staging, FIGURE)
    return report


def _target(settings: CameraAdviceSettings, body: Body) -> str | tuple[str, ...] | None:
    """Return the target of `advise` that --angle or --joint names: the flexion of joints, an angle, or a marker."""
    angle, marker, joints = settings.angle, settings.joint, [*body.anatomy]
    if angle is not None and angle not in body.state_names[4:]:
        if named := joints_named(angle, joints):
            return named
        near = suggested_joint(angle, body.anatomy) or _similar(angle, body.state_names[4:])
        raise InputError(Problem("--angle", "value", repr(angle), _instead(near, _angles_text(body))))
    if marker is not None and marker not in body.markers:
        near = " or ".join(body.anatomy[joint][1] for joint in joints_named(marker, joints))
        all_names = f"one of {', '.join(body.markers)}"
        raise InputError(
            Problem("--joint", "value", repr(marker), _instead(near or _similar(marker, body.markers), all_names))
        )
    return angle or marker


def _angles_text(body: Body) -> str:
    """Return a list of the names that --angle accepts."""
    angles = f"one of {', '.join(body.state_names[4:])}"
    if not body.anatomy:
        return angles
    joints = [joint_and_side(name) for name in body.anatomy]
    one_side = "; with left_ or right_ before the name, of one side" if any(side for _, side in joints) else ""
    names = ", ".join(dict.fromkeys(joint for joint, _ in joints))
    return f"one of {names} (flexion of the joint{one_side}), or an angle of the skeleton, {angles}"


def _instead(near: str | None, all_names: str) -> str:
    return f"perhaps {near}, or {all_names}" if near else all_names


def _similar(name: str, names: Sequence[str]) -> str | None:
    return next(iter(get_close_matches(name, names, 1)), None)


def _position_table(number: int, advice: Advice) -> pd.DataFrame:
    """Return a table of camera positions, in which the precision is NaN where the camera does not see the animal."""
    elevation, azimuth = (grid.ravel() for grid in np.meshgrid(ELEVATIONS_RAD, AZIMUTHS_RAD, indexing="ij"))
    positions = {"azimuth_rad": azimuth, "elevation_rad": elevation, "height_m": advice.distance_m * np.sin(elevation)}
    sigma = np.where(np.isfinite(advice.sigma), advice.sigma, np.nan).ravel()
    known = {f"sigma_{advice.unit}": sigma, "data_share": advice.share.ravel()}
    return pd.DataFrame({"camera": number} | positions | known)
