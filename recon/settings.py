"""All settings of a fit, as they stand in config.toml."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from recon.errors import InputError, Problem
from recon.keypoints import parse_frame_range
from recon.solve import FrameOptions, TrajectoryOptions

DEFAULT_SKELETONS = {"trajectory": "cheetah-24", "frame": "cheetah-8u"}
"""By method."""
OF_METHOD = {
    "trajectory": ("subject", "prior", "ground", "size_sigma", "fast"),
    "frame": ("form", "angle_prior", "camera_rotation", "base_length_m", "base_sigma_m"),
}
"""Settings of the command line that only this method reads."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
FilePath = Annotated[Path, AfterValidator(Path.absolute)]


def _absolute_file(name: str) -> str:
    """A file as its absolute path; the name of something built in as it is."""
    return str(Path(name).absolute()) if name.endswith((".toml", ".npz")) else name


NameOrFile = Annotated[str, AfterValidator(_absolute_file)]


def _width_height(size: Any) -> Any:
    """The text "1920x1080" as (1920, 1080); anything else as it is."""
    match = re.fullmatch(r"\s*([0-9]{1,9})\s*[xX]\s*([0-9]{1,9})\s*", size) if isinstance(size, str) else None
    return (int(match[1]), int(match[2])) if match else size


def _frame_range(text: str) -> str:
    parse_frame_range(text)
    return text


class FitSettings(BaseModel):
    """What `recon fit` is told. Paths are kept absolute, so that config.toml can be run again from anywhere.

    One of camera (a calibration file) and hfov_deg with image_size_px is needed. Fields without a unit in their name
    are counts, names or shares; the solvers' are explained at `recon.solve.FrameOptions` and
    `recon.solve.TrajectoryOptions`. What only the other method reads (`OF_METHOD`) is kept, and has no effect. The
    descriptions end the sentence "expected ..." of an error message.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    keypoints: FilePath = Field(description="a keypoint file, as of DeepLabCut or SLEAP")
    fps: Positive | None = Field(default=None, description="frames per second above 0, as in 120")
    method: Literal["trajectory", "frame"] = Field(default="trajectory", description="trajectory or frame")
    skeleton: NameOrFile | None = Field(default=None, description="the name of a built-in skeleton, or a TOML file")
    subject: NameOrFile | None = Field(
        default=None, description="the name of a built-in subject, or a TOML file with one animal's lengths"
    )
    prior: NameOrFile | None = Field(
        default=None, description="the name of a built-in prior, a file that `recon prior fit` wrote, or none"
    )
    camera: FilePath | None = Field(default=None, description="a camera file")
    camera_name: str | None = Field(default=None, description="the name or number of a camera in the camera file")
    hfov_deg: Annotated[float, Field(gt=0, lt=180)] | None = Field(
        default=None, description="a field of view in degrees, above 0 and below 180"
    )
    image_size_px: Annotated[
        tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]] | None, BeforeValidator(_width_height)
    ] = Field(default=None, description="width x height in pixels, as in 1920x1080")
    tilt_deg: Annotated[float, Field(gt=-90, lt=90)] | None = Field(
        default=None, description="degrees that the camera looks down, above -90 and below 90, as in 5"
    )
    individual: str | None = Field(default=None, description="the name of an animal in the keypoint file")
    frames: Annotated[str, AfterValidator(_frame_range)] | None = Field(
        default=None, description="frame numbers A:B with A < B, from A up to but without B, as in 100:160"
    )
    likelihood_min: Annotated[float, Field(ge=0, le=1)] = Field(default=0.5, description="a number from 0 to 1")
    side: Literal["auto", "left", "right"] = Field(default="auto", description="auto, left or right")
    ground: Literal["auto", "none"] = Field(default="auto", description="auto or none")
    size_sigma: Positive | None = Field(default=None, description="a share of the size above 0, as in 0.1")
    fast: bool = Field(default=False, description="true or false")
    form: Literal["deadband", "printed"] = Field(default="deadband", description="deadband or printed")
    angle_prior: Literal["gaussian", "none"] = Field(default="gaussian", description="gaussian or none")
    camera_rotation: Literal["free", "fixed"] = Field(default="free", description="free or fixed")
    base_length_m: Positive | None = Field(default=None, description="metres above 0, as in 0.203")
    base_sigma_m: Positive | None = Field(default=None, description="metres above 0, as in 0.001")
    sigma_px: Positive = Field(default=FrameOptions.sigma_px, description="pixels above 0, as in 3")
    keypoint_sigma_m: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = Field(
        default=None, description="metres, 0 or more, as in 0.05"
    )
    keypoint_sigma_max_px: Positive = Field(
        default=FrameOptions.keypoint_sigma_max_px, description="pixels above 0, as in 12"
    )
    robust_c: Positive = Field(default=FrameOptions.robust_c, description="a number above 0, as in 4.5")
    tolerance: Positive = Field(default=FrameOptions.tolerance, description="a number above 0, as in 1e-8")
    max_evaluations: Annotated[int, Field(gt=0)] = Field(
        default=FrameOptions.max_evaluations, description="a whole number above 0, as in 400"
    )

    @property
    def skeleton_name(self) -> str:
        """As given, or the method's default."""
        return DEFAULT_SKELETONS[self.method] if self.skeleton is None else self.skeleton

    def frame_options(self) -> FrameOptions:
        return FrameOptions(**{name: getattr(self, name) for name in FrameOptions.__dataclass_fields__})

    def trajectory_options(self) -> TrajectoryOptions:
        names = ("fast", "ground", "sigma_px", "keypoint_sigma_m", "size_sigma")
        return TrajectoryOptions(**{name: getattr(self, name) for name in names})

    def to_toml(self) -> str:
        """The text of config.toml. Settings that are not given are left out."""
        plain = self.model_dump(mode="json", exclude_none=True)
        return tomli_w.dumps({"recon": {"fit": plain}})


def read_settings(config: Path | None, given: dict[str, Any]) -> FitSettings:
    """Settings from a config.toml, overruled by those given on the command line (None: not given).

    Raises InputError, naming every setting that is wrong.
    """
    plain: dict[str, Any] = {}
    if config is not None:
        plain = _read_config(config)
    given = {name: value for name, value in given.items() if value is not None}
    if "camera" in given:
        plain = {k: v for k, v in plain.items() if k not in ("hfov_deg", "image_size_px", "camera_name", "tilt_deg")}
    if "hfov_deg" in given:
        plain = {k: v for k, v in plain.items() if k not in ("camera", "camera_name")}
    plain |= given

    def problem(name: str, found: str, expected: str) -> Problem:
        return Problem(option(name) if name in given or config is None else config, name, found, expected)

    settings, problems = None, []
    try:
        settings = FitSettings.model_validate(plain)
    except ValidationError as error:
        # One message a setting: both numbers of an image size may be wrong.
        for name in dict.fromkeys(str(e["loc"][0]) for e in error.errors()):
            field = FitSettings.model_fields.get(name)
            expected = str(field.description) if field else f"one of {', '.join(FitSettings.model_fields)}"
            found = "an unknown setting" if field is None else repr(plain[name]) if name in plain else "nothing"
            problems.append(problem(name, found, expected))
    has = {name for name, value in plain.items() if value is not None}
    if not has & {"camera", "hfov_deg"}:
        expected = "a camera file, or --hfov-deg with --image-size for a rough one"
        problems.append(problem("camera", "nothing", expected))
    if "camera" in has and "hfov_deg" in has:
        problems.append(problem("hfov_deg", f"{plain['hfov_deg']} beside a camera file", "one of the two"))
    if "camera" not in has and "camera_name" in has:
        problems.append(problem("camera_name", f"{plain['camera_name']!r} without a camera file", "--camera with it"))
    if "camera" not in has and "hfov_deg" in has and "image_size_px" not in has:
        problems.append(problem("image_size_px", "nothing", "the size of the video beside --hfov-deg, as in 1920x1080"))
    method = plain.get("method", FitSettings.model_fields["method"].default)
    problems += _of_the_other_method(method, given)
    if settings is None or problems:
        raise InputError(problems)
    return settings


def _of_the_other_method(method: Any, given: Mapping[str, Any]) -> Iterator[Problem]:
    """A config.toml has the settings of both methods, a command line must not."""
    for other, names in OF_METHOD.items():
        if method in OF_METHOD and method != other:
            for name in names:
                if name in given:
                    found = f"{given[name]!r} with the {method} method"
                    yield Problem(option(name), name, found, f"--method {other} with it")


def option(name: str) -> str:
    """The command line's name for a setting."""
    return {"keypoints": "KEYPOINTS", "image_size_px": "--image-size"}.get(name, "--" + name.replace("_", "-"))


def _read_config(config: Path) -> dict[str, Any]:
    if not config.is_file():
        raise InputError(Problem(config, "file", "no such file", "a config.toml of an earlier run"))
    try:
        document = tomllib.loads(config.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(Problem(config, "content", str(error), "a TOML file")) from None
    table = document.get("recon", {})
    table = table.get("fit") if isinstance(table, dict) else None
    if not isinstance(table, dict):
        raise InputError(Problem(config, "table", ", ".join(document) or "nothing", "[recon.fit]"))
    return table
