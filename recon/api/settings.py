"""Define the settings of a fit, of which config.toml, the report and the command line's options are made."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, cast

import tomli_w
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from recon.base.errors import Problem
from recon.base.file_names import to_encodable
from recon.base.settings import Count, File, NameOrFile, NotNegative, Number, OneOrMore, Option, Positive, Settings
from recon.clip import parse_frame_range

if TYPE_CHECKING:
    from pydantic_core import ArgsKwargs

    from recon.fit.clip_problem import TrajectoryOptions

T = TypeVar("T")
Method = Literal["trajectory", "frame"]
Unit = Literal["m", "cm", "mm"]
UNITS_M: dict[Unit, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
DEFAULT_SKELETONS: dict[Method, str] = {"trajectory": "cheetah-24", "frame": "cheetah-8u"}
"""By method."""


_RARE, _FRAME = Option(common=False), Option(common=False, method="frame")
_TRAJECTORY, _RARE_TRAJECTORY = Option(method="trajectory"), Option(common=False, method="trajectory")

NUMBER = r"[0-9]+(?:\.[0-9]*)?"


def _size(value: object) -> object:
    """Return (width, height) of the text "1920x1080"; numbers as they are."""
    match = re.fullmatch(r"\s*([0-9]{1,9})\s*[xX]\s*([0-9]{1,9})\s*", value) if isinstance(value, str) else None
    return match.groups() if match else value


def _frames(text: str) -> str:
    parse_frame_range(text)
    return text


Size = Annotated[tuple[Count, Count], BeforeValidator(_size)]
"""The size of a picture in pixels: (width, height), or the text "1920x1080"."""
FrameRange = Annotated[str, AfterValidator(_frames)]
"""A:B, from A up to but without B."""

FPS = "Frame rate of the video in Hz, as in 120. (default: what the file says, if it does)"
INDIVIDUAL = "Which animal of a multi-animal file, as in animal1."
RENAME = Option(
    "New names of keypoints: a CSV file of old and new ones, or a built-in map, as in superanimal-quadruped."
)


# -- options that several commands have -------------------------------------------------------------------------------

StrideTimes = Annotated[
    tuple[Number, Number], BeforeValidator(lambda value: value.split(":") if isinstance(value, str) else value)
]
"""(start, end) in seconds since frame 0, or the text "0.31:0.62"."""
FIRST_FRAME = Option("Number that the video's first frame has in the keypoint file, if it was cut.")
ANYWAY = Option('Also of a clip whose verdict is "do not use".')
STRIDE = Option(
    "A stride, in seconds since frame 0, as in 0.31:0.62. (default: one that is found)",
    "START:END in seconds, as in 0.31:0.62",
    metavar="START:END",
)


class FitSettings(Settings):
    """Settings of `recon fit`.

    One of camera (a calibration file) and hfov_deg with image_size_px is needed. Text is taken for numbers, sizes and
    files. Fields without a unit in their name are counts, names or shares; the solvers' are explained at
    `recon.fit.TrajectoryOptions` and by the packages of the other methods.

    Raises
    ------
    InputError
        With everything that is wrong with the settings.
    """

    keypoints: Annotated[
        OneOrMore[File], Option(expected="a keypoint file, or one for each camera", argument="KEYPOINTS")
    ]
    """Keypoint file, as in clip.csv: DeepLabCut, SLEAP, movement, NWB (ndx-pose), COCO, AlphaPose, MMPose, OpenPose
    (any of its files) or a plain table, long or wide; of a clip of several cameras one for each."""
    camera: OneOrMore[File] | None = None
    """Calibration: OpenCV, JARVIS, EasyMocap or ROS yaml/json/xml, AcinoSet scene.json or JSON of other tables,
    OpenDroneMap cameras.json, DANNCE mat, Anipose, Caliscope, Pose2Sim or recon toml; or one such file for each
    camera."""
    camera_name: OneOrMore[str] | None = None
    """Which camera of the file, as in cam2 or 2; once for each keypoint file. (default: whose name the keypoint file's
    name contains)"""
    camera_unit: Unit = "m"
    """Unit of the cameras' positions in the file; Anipose's is often mm."""
    camera_track: Annotated[OneOrMore[File] | None, _TRAJECTORY] = None
    """Where a moving camera was in each frame: a CSV table, a COLMAP text model, or OpenDroneMap's reconstruction.json
    or shots.geojson, with the camera's name in its own. (default: cameras stand still)"""
    fps: Annotated[Positive | None, Option(FPS)] = None
    skeleton: NameOrFile | None = None
    """A built-in skeleton or a TOML file. (default: cheetah-24; cheetah-8u for the frame method)"""
    subject: Annotated[NameOrFile | None, _TRAJECTORY] = None
    """One animal's measured lengths: built-in name or TOML file, as in jules. (default: the skeleton's)"""
    prior: Annotated[NameOrFile | None, _TRAJECTORY] = None
    """What motions are like: a built-in name, a file of recon prior fit, or none. (default: this skeleton's built-in
    one, if any)"""
    hfov_deg: Annotated[Number, Field(gt=0, lt=180)] | None = None
    """Without a calibration: horizontal field of view in degrees, as in 64, or 64+-6 with its uncertainty."""
    image_size_px: Annotated[
        Size | None, Option(expected="width x height in pixels, as in 1920x1080", name="--image-size")
    ] = None
    """Size of the video in pixels, if the camera file lacks it, as in 1920x1080."""
    up: Annotated[str | None, _RARE] = None
    """Which axis of the calibration's world points up, as in z or -y, or a direction, as in 0,-0.9,0.4; first-camera:
    that counts as level. (default: what the file says, or the ground that feet stand on)"""
    tilt_deg: Annotated[Number, Field(ge=-90, le=90)] | None = None
    """Without extrinsics: how far the camera looks down, in degrees, as in 5. (default: level)"""
    height_m: Annotated[Annotated[Number, Field(ge=1e-3, le=10)] | None, _TRAJECTORY] = None
    """Height of the animal at the withers, in metres, as in 1.6. (default: the skeleton's)"""
    belt_speed_m_s: Annotated[Positive | None, _RARE_TRAJECTORY] = None
    """Speed of a treadmill's belt in m/s, as in 1.4: the animal's motion is then that over the belt."""
    individual: Annotated[str | None, Option(INDIVIDUAL)] = None
    rename: Annotated[NameOrFile | None, RENAME] = None
    frames: Annotated[
        FrameRange | None, Option(expected="frame numbers A:B with A < B, from A up to but without B, as in 100:160")
    ] = None
    """Only these frame numbers, from A up to but without B, as in 100:160."""
    corrections: File | None = None
    """Detections that were corrected by hand: corrections.csv, with the columns frame, keypoint, now_x_px, now_y_px and
    camera."""
    fix_swaps: Annotated[bool, _TRAJECTORY] = False
    """Exchange left and right back where they look exchanged."""
    offset_s: Annotated[OneOrMore[Number] | None, _RARE_TRAJECTORY] = None
    """How much later than the first each camera began, in seconds, as in 0.025; once for each keypoint file."""
    fps_known: Annotated[bool, _RARE_TRAJECTORY] = False
    """The frame rate is right, whatever the animal's motion says: evidence against it widens the intervals only."""
    find_offsets: Annotated[bool, _RARE_TRAJECTORY] = False
    """Find when each camera began from the animal's motion; the search begins at offset-s."""
    refine_cameras: Annotated[bool, _RARE_TRAJECTORY] = False
    """Take the poses of all cameras but the first for as good as 2 degrees and 5 cm (2 % of their distance, if that is
    less), and find them with the fit; they go into cameras.toml."""
    focal_sigma: Annotated[Positive | None, _RARE_TRAJECTORY] = None
    """How well focal lengths are known, relative, as in 0.1: one camera's makes the position less certain; several
    cameras' are found and go into cameras.toml. (default: one camera's by its file to 0.02, by a field of view to 0.1;
    several cameras' exactly)"""
    lengths_known: Annotated[bool, _RARE_TRAJECTORY] = False
    """Take the lengths of the skeleton or subject, and where the detector's keypoints lie, for exact. (default: several
    cameras find both with the fit)"""
    camera_fps: Annotated[OneOrMore[Positive] | None, _RARE_TRAJECTORY] = None
    """Frame rates of cameras that differ in it, once for each keypoint file; the first is the result's."""
    method: Annotated[Method, _RARE] = "trajectory"
    """trajectory: the whole animal over the whole clip; frame: one side, one frame after the other."""
    detector: Annotated[NameOrFile | None, _RARE_TRAJECTORY] = None
    """Where the detector's keypoints lie beside the markers: a built-in name, as in acinoset, a TOML file, or none.
    (default: as the subject's or skeleton's file says, or the keypoint file's scorer)"""
    likelihood_min: Annotated[Number, Field(ge=0, le=1), Option(expected="a number from 0 to 1", common=False)] = 0.5
    """Leave out points less likely than this, 0 to 1."""
    side: Annotated[Literal["auto", "left", "right"], _RARE] = "auto"
    """Which side of a one-sided skeleton to fit."""
    ground: Annotated[Literal["auto", "none"], _RARE_TRAJECTORY] = "auto"
    """auto: feet that stand are still and on one plane; none: not."""
    size: Annotated[Annotated[Number, Field(ge=1e-3, le=1e3)] | None, _RARE_TRAJECTORY] = None
    """How many times as large as the skeleton the animal is, as in 0.1."""
    size_sigma: Annotated[Positive | None, _RARE_TRAJECTORY] = None
    """Relative standard deviation of the animal's size, as in 0.1. (default: the skeleton's)"""
    fast: Annotated[bool, _RARE_TRAJECTORY] = False
    """Quicker: fewer directions to start from."""
    form: Annotated[Literal["deadband", "printed"], _FRAME] = "deadband"
    """Ranges and rates: beyond the limit, or two-sided as printed."""
    reprojection: Annotated[Literal["robust", "printed"], _FRAME] = "robust"
    """Errors in the picture: robust and weighted, or as printed."""
    angle_prior: Annotated[Literal["gaussian", "none"], _FRAME] = "gaussian"
    """Priors on angles and heading."""
    camera_rotation: Annotated[Literal["free", "fixed"], _FRAME] = "free"
    """The body's rotation: free, or fixed to the first frame's."""
    path: Annotated[Literal["smooth", "free"], _FRAME] = "smooth"
    """Path of the reference joint: as smooth as an animal moves, or every frame by itself."""
    start_angles: Annotated[str | None, _FRAME] = None
    """Angles of the first frame's start, measured by hand, in degrees, as in th6=55,th7=97,xi=-3. (default: the mean
    pose along the direction of travel)"""
    initial_damping: Annotated[Positive | None, _FRAME] = None
    """First damping of the search in a frame, as in 0.01. (default: MINPACK finds its own)"""
    damping_factor: Annotated[Annotated[Number, Field(gt=1)], _FRAME] = 10.0
    """Factor by which that damping falls after a step that lowers the cost, and grows after each other one."""
    base_length_m: Annotated[Positive | None, _FRAME] = None
    """Base length of the chain in metres, as in 0.203. (default: the skeleton's)"""
    base_sigma_m: Annotated[Positive | None, _FRAME] = None
    """Its standard deviation in metres, as in 0.001. (default: the skeleton's)"""
    sigma_px: Annotated[Positive, _RARE] = 3.0
    """Noise of the detector in pixels, one standard deviation."""
    keypoint_sigma_m: Annotated[NotNegative | None, _RARE] = None
    """How far keypoints lie from the joints, metres, as in 0.05. (default: the skeleton's)"""

    @model_validator(mode="before")
    @classmethod
    def _uncertain_field_of_view(cls, arguments: ArgsKwargs) -> ArgsKwargs:
        """Replace `hfov_deg` with its uncertainty, as in "64+-6", by that and `focal_sigma`."""
        values = arguments.kwargs if arguments.kwargs is not None else {}
        match = re.fullmatch(rf"\s*({NUMBER})\s*(?:±|\+/?-)\s*({NUMBER})\s*", str(values.get("hfov_deg")))
        if match:
            hfov_deg, sigma_deg = map(float, match.groups())
            # The focal length goes with the cotangent of half the angle.
            share = math.radians(sigma_deg) / math.sin(math.radians(hfov_deg)) if 0 < hfov_deg < 180 else None
            values |= {"focal_sigma": values.get("focal_sigma", share), "hfov_deg": hfov_deg}
        return arguments

    @classmethod
    def problems_of_given(cls, values: Mapping[str, Any]) -> Iterator[Problem]:
        """Yield problems of a camera that is given in two ways, and of settings that the method does not read."""
        yield from _camera_problems(values)
        yield from _other_method_problems(values)

    def problems(self) -> Iterator[Problem]:
        """Yield problems of settings that do not go together, or are not there once for each camera."""
        count = len(self.keypoints)
        for name in ("camera_name", "offset_s", "camera_fps"):
            values = getattr(self, name)
            if values is not None and len(values) != count:
                expected = f"one for each keypoint file, that is {count}"
                yield Problem("settings", name, f"{len(values)}: {', '.join(map(str, values))}", expected)
        for name in ("find_offsets", "refine_cameras", "focal_sigma"):
            if getattr(self, name) and name != "focal_sigma" and count == 1:
                yield Problem("settings", name, "one keypoint file", "files of several cameras")
            if getattr(self, name) and name != "find_offsets" and self.camera_track is not None:
                yield Problem("settings", name, "beside a camera track", "cameras that stand still")
        if self.height_m is not None and self.size is not None:
            yield Problem("settings", "height_m", f"{self.height_m:g} beside size, {self.size:g}", "one of the two")
        if self.camera_fps is not None and self.fps is not None:
            yield Problem("settings", "camera_fps", f"beside fps, {self.fps:g}", "one of the two")
        if count > 1 and self.method == "frame":
            actual = f"{count} files with the frame method, which knows one camera"
            yield Problem("settings", "keypoints", actual, "one file, or --set method=trajectory")
        named_tracks = self.camera_track is not None and self.camera_name is not None and self.hfov_deg is None
        if count > 1 and self.camera is None and not named_tracks:
            actual = f"{count} keypoint files without a camera file"
            yield Problem("settings", "camera", actual, "a calibration of all these cameras")
        if len(self.camera_track or ()) > count:
            actual = f"{len(self.camera_track or ())} for {count} keypoint file{'s' * (count > 1)}"
            yield Problem("settings", "camera_track", actual, "one for each camera that moves")
        if len(set(self.keypoints)) < count:
            actual = ", ".join(str(path) for path in self.keypoints)
            yield Problem("settings", "keypoints", actual, "a different file for each camera")

    @property
    def camera_text(self) -> str:
        """Return the camera files in one line; empty without."""
        return ", ".join(str(path) for path in self.camera or ())

    @property
    def keypoints_text(self) -> str:
        """Return the keypoint files in one line."""
        return ", ".join(str(path) for path in self.keypoints)

    def keypoints_from(self, folder: Path) -> list[str]:
        """Return the keypoint files as seen from a folder."""
        return setting_seen_from(folder, "keypoints", [str(path) for path in self.keypoints])

    @property
    def skeleton_name(self) -> str:
        """Return the skeleton's name as given, or the method's default."""
        return DEFAULT_SKELETONS[self.method] if self.skeleton is None else self.skeleton

    @property
    def seeks_cameras(self) -> bool:
        """Return whether the fit changes the cameras of the file."""
        return bool(self.refine_cameras) or (self.focal_sigma is not None and len(self.keypoints) > 1)

    def trajectory_options(self) -> TrajectoryOptions:
        """Return the options that the trajectory method's solver reads."""
        from recon.fit.clip_problem import TrajectoryOptions, focal_sigma_of

        values = {field.name: getattr(self, field.name) for field in fields(TrajectoryOptions)}
        given = {name: getattr(self, name) for name in ("focal_sigma", "camera_track", "hfov_deg")}
        return TrajectoryOptions(**values | {"focal_sigma": focal_sigma_of(given, len(self.keypoints))})

    def plain(self, folder: Path | None = None) -> dict[str, Any]:
        """Return all settings that the method reads, as plain JSON types.

        Parameters
        ----------
        folder
            Folder that paths are relative to, as `setting_in_folder` reads them; None: paths are absolute.

        Returns
        -------
        dict
            Values by name; None for a setting that is not given and has no default.
        """
        of_method = {name: info for name, info in SETTINGS.items() if info.option.method in (None, self.method)}
        plain = {name: info.plain(getattr(self, name)) for name, info in of_method.items()}
        return (
            plain if folder is None else {name: setting_seen_from(folder, name, value) for name, value in plain.items()}
        )

    def to_toml(self, folder: Path | None = None, sha256: Mapping[str, str] | None = None) -> str:
        """Return the text of config.toml, without settings that are not given.

        Parameters
        ----------
        folder
            Folder that paths are relative to, as for `plain`.
        sha256
            Digests of the input files by their role, which are written beside the settings.
        """
        values = {name: value for name, value in self.plain(folder).items() if value is not None}
        plain = to_encodable(values)
        return tomli_w.dumps({"recon": {"fit": plain, **({"sha256": sha256} if sha256 else {})}})


SETTINGS = FitSettings.infos()
"""By name, in the order of `FitSettings`."""
OF_ANY_CLIP = tuple(name for name in SETTINGS if name not in ("keypoints", "corrections"))
"""The settings that several clips can have in common."""


def setting_seen_from(folder: Path, name: str, value: T) -> T:
    """Return a setting's value with its paths as seen from a folder."""
    from recon.base.files import seen_from

    return with_paths(name, value, lambda path: seen_from(folder, path))


def with_paths(name: str, value: T, change: Callable[[str], str]) -> T:
    """Return a setting's value with its paths changed; other values as they are."""
    if isinstance(value, list):
        return cast("T", [with_paths(name, element, change) for element in value])
    if isinstance(value, str) and name in SETTINGS and SETTINGS[name].is_file(value):
        return cast("T", change(value))
    return value


def _camera_problems(values: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield problems of a camera that is given in two ways, or without what belongs to it."""
    if not values.keys() & {"camera", "hfov_deg", "camera_track"}:
        expected = "a camera file, or --hfov-deg with --image-size for a rough one"
        yield Problem("settings", "camera", "nothing", expected)
    if "camera" in values and "hfov_deg" in values:
        yield Problem("settings", "hfov_deg", f"{values['hfov_deg']} beside a camera file", "one of the two")
    if "camera_track" in values and "tilt_deg" in values:
        actual = f"{values['tilt_deg']} beside a camera track, which says which way is up"
        yield Problem("settings", "tilt_deg", actual, "one of the two")
    if not values.keys() & {"camera", "camera_track"} and "camera_name" in values:
        actual = f"{values['camera_name']!r} without a camera file"
        yield Problem("settings", "camera_name", actual, "--camera with it")
    if "camera" not in values and values.get("camera_unit", "m") != "m":
        actual = f"{values['camera_unit']!r} without a camera file"
        yield Problem("settings", "camera_unit", actual, "--camera with it")
    if "camera" not in values and "hfov_deg" in values and "image_size_px" not in values:
        expected = "the size of the video beside --hfov-deg, as in 1920x1080"
        yield Problem("settings", "image_size_px", "nothing", expected)


def _other_method_problems(values: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield problems of settings that the method does not read; the method may be no text, as a list in a file."""
    method = values.get("method", SETTINGS["method"].default)
    for name, value in values.items():
        info = SETTINGS.get(name)
        if info is None or value == info.default:
            continue
        owner = info.option.method
        if isinstance(method, str) and method in DEFAULT_SKELETONS and owner not in (None, method):
            actual = f"{info.plain(value)!r} with the {method} method, which does not read it"
            yield Problem("settings", name, actual, f"nothing, or --set method={owner} with it")
