"""All settings of a fit, as they stand in config.toml."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from recon.errors import InputError, Problem
from recon.solve import FrameOptions

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class FitSettings(BaseModel):
    """What `recon fit` is told. Paths are kept absolute in config.toml, so that it can be run again from anywhere.

    One of camera (a calibration file) and hfov_deg with image_size_px is needed. Fields without a unit in their name
    are counts, names or shares; the solver's are explained at `recon.solve.FrameOptions`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    keypoints: Path
    fps: Positive
    skeleton: str = "cheetah-8u"
    method: Literal["frame"] = "frame"
    camera: Path | None = None
    camera_name: str | None = None
    hfov_deg: Annotated[float, Field(gt=0, lt=180)] | None = None
    image_size_px: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]] | None = None
    individual: str | None = None
    frames: str | None = None
    likelihood_min: Annotated[float, Field(ge=0, le=1)] = 0.5
    side: Literal["auto", "left", "right"] = "auto"
    form: Literal["deadband", "printed"] = "deadband"
    angle_prior: Literal["gaussian", "none"] = "gaussian"
    camera_rotation: Literal["free", "fixed"] = "free"
    base_length_m: Positive | None = None
    base_sigma_m: Positive | None = None
    sigma_px: Positive = FrameOptions.sigma_px
    keypoint_sigma_m: Annotated[float, Field(ge=0)] | None = None
    keypoint_sigma_max_px: Positive = FrameOptions.keypoint_sigma_max_px
    robust_c: Positive = FrameOptions.robust_c
    tolerance: Positive = FrameOptions.tolerance
    max_evaluations: Annotated[int, Field(gt=0)] = FrameOptions.max_evaluations

    def frame_options(self) -> FrameOptions:
        return FrameOptions(**{name: getattr(self, name) for name in FrameOptions.__dataclass_fields__})

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
        plain = {k: v for k, v in plain.items() if k not in ("hfov_deg", "image_size_px", "camera_name")}
    if "hfov_deg" in given:
        plain = {k: v for k, v in plain.items() if k not in ("camera", "camera_name")}
    plain |= given
    try:
        settings = FitSettings.model_validate(plain)
    except ValidationError as error:
        raise InputError(_problem(e, given, config) for e in error.errors()) from None
    if settings.camera is None and settings.hfov_deg is None:
        raise InputError(
            Problem("--camera", "calibration", "none", "a camera file, or --hfov-deg with --image-size for a rough one")
        )
    if settings.camera is not None and settings.hfov_deg is not None:
        raise InputError(Problem("--hfov-deg", "with --camera", str(settings.hfov_deg), "one of the two, not both"))
    if settings.hfov_deg is not None and settings.image_size_px is None:
        raise InputError(Problem("--image-size", "with --hfov-deg", "none", "the video's size, as in 1920x1080"))
    return settings


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


def _problem(error: Any, given: dict[str, Any], config: Path | None) -> Problem:
    name = str(error["loc"][0]) if error["loc"] else "settings"
    option = "--" + name.removesuffix("_px").replace("_", "-")
    where = option if name in given or config is None else config
    found = "nothing" if error["type"] == "missing" else repr(error["input"])
    return Problem(where, name, found, error["msg"])
