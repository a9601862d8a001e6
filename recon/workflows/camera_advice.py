"""`recon camera-advice`: where to put a camera, or a second one, to see an angle or a joint."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from recon.animal import Body, load_prior, load_skeleton
from recon.base.errors import Problem, refuse
from recon.base.files import require_free_folder, staged_folder
from recon.base.settings import Integer, Number, Option, Settings
from recon.calibrate.camera_advice import PICTURE_PX, Advice, advise
from recon.fit.motion import MEASURED_SHARE
from recon.io import write_rows
from recon.show import plots
from recon.show.plain import to_json
from recon.show.plots.advice import in_words

REPORT, TABLE, FIGURE = "camera_advice.json", "camera_advice.csv", "camera_advice"
DIRECTIONS = (
    *("ahead of it", "ahead to its left", "on its left side", "behind to its left"),
    *("behind it", "behind to its right", "on its right side", "ahead to its right"),
)
HIGH_RAD = ((np.radians(15), "level with its middle"), (np.radians(45), "raised"), (np.radians(70), "high up"))
ABOVE = "almost above it"


def in_sentences(found: Sequence[Advice]) -> Iterator[str]:
    """What to do: of one camera, or of the best first one and a second beside it."""
    for number, advice in enumerate(found, start=1):
        camera = "the camera" if len(found) == 1 else f"camera {number}"
        share, sigma = (float(values[advice.best]) for values in (advice.share, advice.sigma))
        yield (
            f"Put {camera} {where(*advice.place)}, {advice.distance_m * np.sin(advice.place[1]):.2g} m above its "
            f"middle and {advice.distance_m:.3g} m away: {share:.0%} of the precision of {advice.of} comes from "
            f"the pixels, ±{in_words(sigma, advice.unit)}."
        )
    worst = np.unravel_index(int(np.argmax(found[0].sigma)), found[0].sigma.shape)
    place = found[0].azimuths_rad[worst[1]], found[0].elevations_rad[worst[0]]
    sigma = float(found[0].sigma[worst])
    said = f"±{in_words(sigma, found[0].unit)}" if np.isfinite(sigma) else "it is not in the picture"
    yield f"The worst place for one camera is {where(*map(float, place))}: {said}."
    if found[-1].share.max() < MEASURED_SHARE:
        yield "No place shows it well: what is expected of it says more than the pixels everywhere."


def where(azimuth_rad: float, elevation_rad: float) -> str:
    direction = DIRECTIONS[round(azimuth_rad / (np.pi / 4)) % 8]
    height = next((text for limit, text in HIGH_RAD if elevation_rad < limit), ABOVE)
    return f"{direction}, {height} ({np.degrees(azimuth_rad):.0f}°)" if height != ABOVE else f"{ABOVE}, {direction}"


class CameraAdviceSettings(Settings):
    """What `recon camera-advice` is told."""

    skeleton: Annotated[str, Option("A built-in skeleton or a TOML file, as in cheetah-24.")]
    out: Annotated[Path, Option("Folder for the figure, the table and the report.")]
    prior: Annotated[
        str | None,
        Option("What motions are like: a built-in name, a file of recon prior fit, or none. (default: as for a fit)"),
    ] = None
    angle: Annotated[str | None, Option("The angle to be seen, as in front_trunk_yaw.")] = None
    joint: Annotated[str | None, Option("The joint to be seen. (default: all)")] = None
    cameras: Annotated[Integer, Option("1, or 2: the best second one beside the best first one.")] = 1
    hfov_deg: Annotated[Number, Option("Horizontal field of view, degrees.", "degrees, as in 60")] = 60.0
    distance_m: Annotated[
        Number | None,
        Option("From the animal's middle, metres. (default: 4 of its lengths)", "metres, as in 8"),
    ] = None
    subject: Annotated[str | None, Option("A measured animal: built-in name or TOML file.")] = None
    overwrite: Annotated[bool, Option("Replace earlier advice.")] = False


def run_camera_advice(
    settings: CameraAdviceSettings, progress: Callable[[str, float], None] = lambda stage, share: None
) -> dict[str, Any]:
    """See `recon.calibrate.camera_advice.advise`; cameras: 1, or 2, of which the second is looked for beside the best
    first one. Writes a report, which it gives, a table and a figure into `out`. Raises InputError."""
    body = load_skeleton(settings.skeleton, settings.subject)
    _require(body, settings.angle, settings.joint, settings.cameras, settings.hfov_deg, settings.distance_m)
    motions = load_prior(settings.prior, body)
    require_free_folder(settings.out, (REPORT, TABLE, f"{FIGURE}.png", f"{FIGURE}.svg"), settings.overwrite, "advice")
    found: list[Advice] = []
    for number in range(settings.cameras):
        beside = found[0].place if found else None
        found.append(
            advise(
                body,
                motions,
                settings.angle,
                settings.joint,
                settings.hfov_deg,
                settings.distance_m,
                beside,
                progress=lambda share, done=number: progress("cameras", (done + share) / settings.cameras),
            )
        )
    report = _report(found, body, motions.name, settings.hfov_deg) | {"words": [*in_sentences(found)]}
    with staged_folder(settings.out) as staging:
        (staging / REPORT).write_text(to_json(report), encoding="utf-8")
        columns = "camera, azimuth_rad, elevation_rad, height_m, sigma_" + found[0].unit + ", data_share"
        write_rows(staging / TABLE, [columns.split(", ")], _rows(found))
        plots.save(plots.camera_advice(found), staging, FIGURE)
    return report


def _require(
    body: Body, angle: str | None, joint: str | None, cameras: int, hfov_deg: float, distance_m: float | None
) -> None:
    angles = body.state_names[4:]
    checks = [
        (angle is None or joint is None, "--angle", "--joint as well", "one of the two, or neither for all joints"),
        (angle is None or angle in angles, "--angle", repr(angle), f"one of {', '.join(angles)}"),
        (joint is None or joint in body.markers, "--joint", repr(joint), f"one of {', '.join(body.markers)}"),
        (cameras in (1, 2), "--cameras", str(cameras), "1 or 2"),
        (0 < hfov_deg < 180, "--hfov-deg", f"{hfov_deg:g}", "degrees between 0 and 180"),
        (distance_m is None or 0 < distance_m < 1e4, "--distance-m", f"{distance_m}", "metres above 0, up to 10,000"),
    ]
    refuse(Problem(option, "value", found, expected) for ok, option, found, expected in checks if not ok)


def _report(found: Sequence[Advice], body: Body, prior: str, hfov_deg: float) -> dict[str, Any]:
    return {
        "schema": {"name": "recon.camera_advice", "version": 1},
        "skeleton": body.name,
        "prior": prior,
        "of": found[0].of,
        "hfov_deg": hfov_deg,
        "image_size_px": PICTURE_PX,
        "distance_m": found[0].distance_m,
        "cameras": [
            {
                "azimuth_rad": advice.place[0],
                "elevation_rad": advice.place[1],
                "height_m": advice.distance_m * np.sin(advice.place[1]),
                f"sigma_{advice.unit}": float(advice.sigma[advice.best]),
                "data_share": float(advice.share[advice.best]),
            }
            for advice in found
        ],
    }


def _rows(found: Sequence[Advice]) -> Iterator[Sequence[Any]]:
    for number, advice in enumerate(found, start=1):
        for row, elevation in enumerate(advice.elevations_rad):
            for column, azimuth in enumerate(advice.azimuths_rad):
                height = advice.distance_m * np.sin(elevation)
                sigma, share = advice.sigma[row, column], advice.share[row, column]
                yield number, azimuth, elevation, height, sigma if np.isfinite(sigma) else np.nan, share
