"""Define the settings of a fit, from which config.toml, the report and the command line's options are made."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, cast

import tomli_w
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from recon.api.options import INDIVIDUAL, RENAME
from recon.base.errors import Problem
from recon.base.file_names import to_encodable
from recon.base.numbers import counted
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
"""Default skeleton of each method."""


_RARE, _FRAME = Option(common=False), Option(common=False, method="frame")
_TRAJECTORY, _RARE_TRAJECTORY = Option(method="trajectory"), Option(common=False, method="trajectory")

NUMBER = r"[0-9]+(?:\.[0-9]*)?"


def _size(value: object) -> object:
    """Return (width, height) from text such as "1920x1080", or any other value unchanged."""
    match = re.fullmatch(r"\s*([0-9]{1,9})\s*[xX]\s*([0-9]{1,9})\s*", value) if isinstance(value, str) else None
    return match.groups() if match else value


def _frames(text: str) -> str:
    parse_frame_range(text)
    return text


Size = Annotated[tuple[Count, Count], BeforeValidator(_size)]
"""The size of a picture in pixels: (width, height), or the text "1920x1080"."""
FrameRange = Annotated[str, AfterValidator(_frames)]
"""Range of frames A:B, which includes A and excludes B."""

FPS = "Frame rate of the video in Hz, such as 120. (default: that of the file, if it states one)"


class FitSettings(Settings):
    """Settings of `recon fit`.

    Either `camera` (a calibration file) or `hfov_deg` with `image_size_px` is required. Numbers, sizes and files may be
    given as text. Fields without a unit in their name are counts, names or fractions. `recon.fit.TrajectoryOptions`
    explains the solver's options.

    Raises
    ------
    InputError
        If settings are wrong. The message lists all problems.
    """

    keypoints: Annotated[
        OneOrMore[File], Option(expected="a keypoint file, or one for each camera", argument="KEYPOINTS")
    ]
    """Keypoint file, such as clip.csv: DeepLabCut, SLEAP, movement, NWB (ndx-pose), COCO, AlphaPose, MMPose, OpenPose
    (any of its files) or a plain table, long or wide. For a clip from several cameras, give one file per camera.
    """
    camera: OneOrMore[File] | None = None
    """Calibration: OpenCV, JARVIS, EasyMocap or ROS yaml/json/xml, AcinoSet scene.json or JSON of other tables,
    OpenDroneMap cameras.json, DANNCE mat, Anipose, Caliscope, Pose2Sim or recon toml; or one such file per camera.
    """
    camera_name: OneOrMore[str] | None = None
    """Name of the camera in the file, such as cam2 or 2, once per keypoint file. (default: the camera whose name the
    keypoint file's name contains)
    """
    camera_unit: Unit = "m"
    """Unit of the cameras' positions in the file, which is often mm for Anipose."""
    camera_track: Annotated[OneOrMore[File] | None, _TRAJECTORY] = None
    """Pose of a moving camera in each frame: a CSV table, a COLMAP text model, or OpenDroneMap's reconstruction.json or
    shots.geojson. The file name must contain the camera's name. (default: the cameras are static)
    """
    fps: Annotated[Positive | None, Option(FPS)] = None
    skeleton: NameOrFile | None = None
    """A built-in skeleton or a TOML file. (default: cheetah-24; cheetah-8u for the frame method)"""
    subject: Annotated[NameOrFile | None, _TRAJECTORY] = None
    """Measured lengths of one animal: built-in name or TOML file, such as jules. (default: the skeleton's lengths)"""
    prior: Annotated[NameOrFile | None, _TRAJECTORY] = None
    """Motion prior: a built-in name, a file from recon prior fit, or none. (default: the skeleton's built-in prior, if
    any)
    """
    hfov_deg: Annotated[Number, Field(gt=0, lt=180)] | None = None
    """Horizontal field of view in degrees, if there is no calibration, such as 64, or 64+-6 with its uncertainty. For
    the wide modes of action cameras, give --set lens=fisheye as well.
    """
    lens: Annotated[Literal["pinhole", "fisheye"] | None, _RARE] = None
    """Lens of a camera given by its field of view: fisheye for the wide modes of action cameras, pinhole for a picture
    without distortion. (default: pinhole, with a warning if the field of view is wider than 90 degrees)
    """
    image_size_px: Annotated[
        Size | None, Option(expected="width x height in pixels, such as 1920x1080", name="--image-size")
    ] = None
    """Size of the video in pixels, such as 1920x1080, if the camera file lacks it."""
    up: Annotated[str | None, _RARE] = None
    """Upward axis of the calibration's world, such as z or -y, or a direction, such as 0,-0.9,0.4, or first-camera if
    the first camera is level. (default: as stated in the file, or upwards from the ground under the feet in stance)
    """
    tilt_deg: Annotated[Number, Field(ge=-90, le=90)] | None = None
    """Angle in degrees by which the camera looks down, such as 5, if there are no extrinsics. (default: level)"""
    height_m: Annotated[Annotated[Number, Field(ge=1e-3, le=10)] | None, _TRAJECTORY] = None
    """Height of the animal at the withers, in metres, such as 1.6. (default: the skeleton's)"""
    belt_speed_m_s: Annotated[Positive | None, _RARE_TRAJECTORY] = None
    """Speed of a treadmill's belt in m/s, such as 1.4, relative to which the animal's motion is reported."""
    individual: Annotated[str | None, Option(INDIVIDUAL)] = None
    rename: Annotated[NameOrFile | None, RENAME] = None
    frames: Annotated[
        FrameRange | None, Option(expected="frame numbers A:B with A < B, from A to B - 1, such as 100:160")
    ] = None
    """Use only the frames A:B, from number A up to but not including B, such as 100:160."""
    corrections: File | None = None
    """File of detections that were corrected by hand, such as corrections.csv, with the columns frame, keypoint,
    now_x_px, now_y_px and camera.
    """
    fix_swaps: Annotated[bool, _TRAJECTORY] = False
    """Undo left-right swaps where they are found."""
    offset_s: Annotated[OneOrMore[Number] | None, _RARE_TRAJECTORY] = None
    """Time in seconds by which each camera began later than the first, such as 0.025, once per keypoint file."""
    fps_known: Annotated[bool, _RARE_TRAJECTORY] = False
    """Trust the frame rate. If the animal's motion contradicts it, the intervals widen, but no warning is given."""
    cameras_known: Annotated[bool, _RARE_TRAJECTORY] = False
    """Trust the cameras' poses. (default: of two cameras, one that was probably turned or moved is refined, and errors
    of a tenth of a degree and 1 cm, or rarely of several degrees and decimetres, count in the uncertainty)
    """
    find_offsets: Annotated[bool, _RARE_TRAJECTORY] = False
    """Find from the animal's motion when each camera began. The search starts at offset-s."""
    refine_cameras: Annotated[bool, _RARE_TRAJECTORY] = False
    """Refine the poses of all cameras but the first during the fit, assuming errors of 2 degrees and 5 cm (2 % of the
    camera's distance, if that is less), and write them to cameras.toml.
    """
    focal_sigma: Annotated[Positive | None, _RARE_TRAJECTORY] = None
    """Relative uncertainty of the focal lengths, such as 0.1. With one camera, the position becomes less certain. With
    several, the focal lengths are estimated and written to cameras.toml. (default: with one camera, 0.02 if a file
    gives the focal length and 0.1 if a field of view does; with several cameras, exact)
    """
    lengths_known: Annotated[bool, _RARE_TRAJECTORY] = False
    """Treat the lengths of the skeleton or subject, and the detector's keypoint offsets, as exact. (default: with
    several cameras, both are estimated in the fit)
    """
    camera_fps: Annotated[OneOrMore[Positive] | None, _RARE_TRAJECTORY] = None
    """Frame rates of the cameras if they differ, once per keypoint file. The result has the first camera's rate."""
    playback: Annotated[bool | Literal["auto"], Option(expected="auto, true or false", common=False)] = "auto"
    """Write the playback, motion.rrd: true, false, or auto for clips of at most 2000 frames. The playback of a longer
    clip takes more than a third of the space of its results. recon view makes a missing playback.
    """
    method: Annotated[Method, _RARE] = "trajectory"
    """Method of the fit: trajectory for the whole animal over the whole clip, frame for one side, frame by frame."""
    detector: Annotated[NameOrFile | None, _RARE_TRAJECTORY] = None
    """Offsets of the detector's keypoints from the markers: a built-in name, such as acinoset, a TOML file, or none.
    (default: as stated by the file of the subject or skeleton, or by the scorer in the keypoint file)
    """
    likelihood_min: Annotated[Number, Field(ge=0, le=1), Option(expected="a number from 0 to 1", common=False)] = 0.5
    """Leave out points with a likelihood below this, 0 to 1."""
    side: Annotated[Literal["auto", "left", "right"], _RARE] = "auto"
    """Side of the animal to fit with a skeleton of one side."""
    ground: Annotated[Literal["auto", "none"], _RARE_TRAJECTORY] = "auto"
    """Assumption about the ground: auto if standing feet do not move and are on one plane, none without assumption."""
    size: Annotated[Annotated[Number, Field(ge=1e-3, le=1e3)] | None, _RARE_TRAJECTORY] = None
    """Size of the animal relative to the skeleton, such as 0.1."""
    size_sigma: Annotated[Positive | None, _RARE_TRAJECTORY] = None
    """Relative standard deviation of the animal's size, such as 0.1. (default: the skeleton's)"""
    fast: Annotated[bool, _RARE_TRAJECTORY] = False
    """Save time by starting from fewer directions."""
    form: Annotated[Literal["deadband", "printed"], _FRAME] = "deadband"
    """Penalties on ranges and rates: deadband to penalise only values beyond the limit, printed as published."""
    reprojection: Annotated[Literal["robust", "printed"], _FRAME] = "robust"
    """Cost of reprojection errors: robust for a robust and weighted cost, printed for the cost as published."""
    angle_prior: Annotated[Literal["gaussian", "none"], _FRAME] = "gaussian"
    """Priors of angles and heading: gaussian or none."""
    camera_rotation: Annotated[Literal["free", "fixed"], _FRAME] = "free"
    """Rotation between the camera and the body: free in every frame, or fixed at its value in the first frame."""
    path: Annotated[Literal["smooth", "free"], _FRAME] = "smooth"
    """Path of the reference joint: as smooth as an animal moves, or free in every frame."""
    path_sigma_m: Annotated[Positive, _FRAME] = 0.5
    """Standard deviation of the reference joint about a smooth path, in metres. A smaller value makes the poses' depths
    smoother.
    """
    start_angles: Annotated[str | None, _FRAME] = None
    """Start angles of the first frame, measured by hand, in degrees, such as th6=55,th7=97,xi=-3. (default: the mean
    pose along the direction of travel)
    """
    initial_damping: Annotated[Positive | None, _FRAME] = None
    """First damping of a search, such as 0.01. (default: chosen by MINPACK)"""
    damping_factor: Annotated[Annotated[Number, Field(gt=1)], _FRAME] = 10.0
    """Factor by which the damping falls after a step that lowers the cost, and grows after any other step."""
    base_length_m: Annotated[Positive | None, _FRAME] = None
    """Base length of the chain in metres, such as 0.203. (default: the skeleton's)"""
    base_sigma_m: Annotated[Positive | None, _FRAME] = None
    """Standard deviation of the base length in metres, such as 0.001. (default: the skeleton's)"""
    sigma_px: Annotated[Positive, _RARE] = 3.0
    """Noise of the detector in pixels, one standard deviation."""
    keypoint_sigma_m: Annotated[NotNegative | None, _RARE] = None
    """Distance of keypoints from the joints, one standard deviation, in metres, such as 0.05. (default: the
    skeleton's)
    """

    @model_validator(mode="before")
    @classmethod
    def _uncertain_field_of_view(cls, arguments: ArgsKwargs) -> ArgsKwargs:
        """Replace `hfov_deg` with an uncertainty, such as "64+-6", by a plain value and `focal_sigma`."""
        values = arguments.kwargs if arguments.kwargs is not None else {}
        match = re.fullmatch(rf"\s*({NUMBER})\s*(?:±|\+/?-)\s*({NUMBER})\s*", str(values.get("hfov_deg")))
        if match:
            hfov_deg, sigma_deg = map(float, match.groups())
            # The focal length is proportional to the cotangent of half the angle; that of a fisheye lens, to 1 / angle.
            angle = math.radians(hfov_deg)
            per_rad = angle if values.get("lens") == "fisheye" else math.sin(angle)
            fraction = math.radians(sigma_deg) / per_rad if 0 < hfov_deg < 180 else None
            values |= {"focal_sigma": values.get("focal_sigma", fraction), "hfov_deg": hfov_deg}
        return arguments

    @classmethod
    def problems_of_given(cls, values: Mapping[str, Any]) -> Iterator[Problem]:
        """Yield problems with a camera given in two ways, and with settings that the method does not read."""
        yield from _camera_problems(values)
        yield from _other_method_problems(values)

    def problems(self) -> Iterator[Problem]:
        """Yield problems with settings that exclude each other, or that are not given once per camera."""
        count = len(self.keypoints)
        for name in ("camera_name", "offset_s", "camera_fps"):
            values = getattr(self, name)
            if values is not None and len(values) != count:
                expected = f"{counted(count, 'value')}, one for each keypoint file"
                expected += ", each after the option's name" if len(values) < count else ""
                yield Problem("settings", name, f"{len(values)}: {', '.join(map(str, values))}", expected)
        for name in ("find_offsets", "refine_cameras"):
            if getattr(self, name) and count == 1:
                yield Problem("settings", name, "one keypoint file", "files of several cameras")
        for name in ("refine_cameras", "focal_sigma"):
            if getattr(self, name) and self.camera_track is not None:
                yield Problem("settings", name, "a camera track as well", "static cameras")
        if self.cameras_known and self.refine_cameras:
            yield Problem("settings", "cameras_known", "refine_cameras as well", "only one of the two")
        if self.height_m is not None and self.size is not None:
            yield Problem("settings", "height_m", f"{self.height_m:g} and size {self.size:g}", "only one of the two")
        if self.camera_fps is not None and self.fps is not None:
            yield Problem("settings", "camera_fps", f"fps {self.fps:g} as well", "only one of the two")
        if count > 1 and self.method == "frame":
            actual = f"{count} files with the frame method, which uses one camera"
            yield Problem("settings", "keypoints", actual, "one file, or --set method=trajectory")
        yield from self._camera_file_problems()

    def _camera_file_problems(self) -> Iterator[Problem]:
        """Yield problems with the numbers of camera files and tracks, and with keypoint files given twice."""
        count = len(self.keypoints)
        named_tracks = self.camera_track is not None and self.camera_name is not None and self.hfov_deg is None
        if count > 1 and self.camera is None and not named_tracks:
            actual = f"{count} keypoint files without a camera file"
            yield Problem("settings", "camera", actual, "a calibration of all these cameras")
        if len(self.camera_track or ()) > count:
            actual = f"{counted(len(self.camera_track or ()), 'track')} for {count} keypoint file{'s' * (count > 1)}"
            yield Problem("settings", "camera_track", actual, "one track for each camera that moves")
        if len(set(self.keypoints)) < count:
            actual = ", ".join(str(path) for path in self.keypoints)
            yield Problem("settings", "keypoints", actual, "a different file for each camera")

    @property
    def camera_text(self) -> str:
        """Return the camera files in one line, or "" if there are none."""
        return ", ".join(str(path) for path in self.camera or ())

    @property
    def keypoints_text(self) -> str:
        """Return the keypoint files in one line."""
        return ", ".join(str(path) for path in self.keypoints)

    def keypoints_from(self, folder: Path) -> list[str]:
        """Return the paths of the keypoint files relative to a folder."""
        return setting_with_relative_paths(folder, "keypoints", [str(path) for path in self.keypoints])

    @property
    def skeleton_name(self) -> str:
        """Return the given skeleton's name, or the default of the method."""
        return DEFAULT_SKELETONS[self.method] if self.skeleton is None else self.skeleton

    @property
    def seeks_cameras(self) -> bool:
        """Return whether the fit changes the cameras of the camera file."""
        return bool(self.refine_cameras) or (self.focal_sigma is not None and len(self.keypoints) > 1)

    def trajectory_options(self) -> TrajectoryOptions:
        """Return the options that the trajectory method's solver reads."""
        from recon.fit.clip_problem import TrajectoryOptions
        from recon.fit.constants import focal_sigma_of

        names = [field.name for field in fields(TrajectoryOptions) if hasattr(self, field.name)]
        values: dict[str, Any] = {name: getattr(self, name) for name in names}
        camera_settings = {name: getattr(self, name) for name in ("focal_sigma", "camera_track", "hfov_deg")}
        values["focal_sigma"] = focal_sigma_of(camera_settings, len(self.keypoints))
        return TrajectoryOptions(**values)

    def plain(self, folder: Path | None = None) -> dict[str, Any]:
        """Return all settings that the method reads, as plain JSON types.

        Parameters
        ----------
        folder
            Folder to which paths are made relative, for `setting_in_folder` to read; None for absolute paths.

        Returns
        -------
        dict
            Values keyed by the settings' names; None if a setting is not given and has no default.
        """
        of_method = {name: info for name, info in SETTINGS.items() if info.option.method in (None, self.method)}
        plain = {name: info.plain(getattr(self, name)) for name, info in of_method.items()}
        return (
            plain
            if folder is None
            else {name: setting_with_relative_paths(folder, name, value) for name, value in plain.items()}
        )

    def to_toml(self, folder: Path | None = None, sha256: Mapping[str, str] | None = None) -> str:
        """Return the text of config.toml, without settings that are not given.

        Parameters
        ----------
        folder
            Folder to which paths are made relative, as in `plain`.
        sha256
            Digests of the input files, as `input_digests` returns them, which are written next to the settings.
        """
        values = {name: value for name, value in self.plain(folder).items() if value is not None}
        plain = to_encodable(values)
        return tomli_w.dumps({"recon": {"fit": plain, **({"sha256": sha256} if sha256 else {})}})


SETTINGS = FitSettings.infos()
"""Settings keyed by their names, in the order of `FitSettings`."""
OF_ANY_CLIP = tuple(name for name in SETTINGS if name not in ("keypoints", "corrections"))
"""Names of the settings that several clips can share."""
TRIANGULATION_SETTINGS = (
    *("keypoints", "camera", "camera_name", "camera_unit", "camera_track", "fps", "image_size_px", "up"),
    *("individual", "rename", "frames", "offset_s", "camera_fps", "likelihood_min", "sigma_px"),
)
"""Settings of a fit that triangulation reads."""


def setting_with_relative_paths(folder: Path, name: str, value: T) -> T:
    """Return a setting's value with its paths relative to a folder."""
    from recon.base.files import relative_path

    return with_paths(name, value, lambda path: relative_path(folder, path))


def with_paths(name: str, value: T, change: Callable[[str], str]) -> T:
    """Return a setting's value with `change` applied to each path in the value."""
    if isinstance(value, list):
        return cast("T", [with_paths(name, element, change) for element in value])
    if isinstance(value, str) and name in SETTINGS and SETTINGS[name].is_file(value):
        return cast("T", change(value))
    return value


def _camera_problems(values: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield problems with a camera that is given in two ways, or incompletely."""
    if not values.keys() & {"camera", "hfov_deg", "camera_track"}:
        expected = "a camera file, or --hfov-deg with --image-size for a rough one"
        yield Problem("settings", "camera", "nothing", expected)
    if "camera" in values and "hfov_deg" in values:
        yield Problem("settings", "hfov_deg", f"{values['hfov_deg']} and a camera file", "only one of the two")
    if "lens" in values and "hfov_deg" not in values:
        expected = "--hfov-deg as well; a camera file states its own lens"
        yield Problem("settings", "lens", f"{values['lens']!r} without a field of view", expected)
    if "camera_track" in values and "tilt_deg" in values:
        actual = f"{values['tilt_deg']} together with a camera track, which states which way is up"
        yield Problem("settings", "tilt_deg", actual, "only one of the two")
    if not values.keys() & {"camera", "camera_track"} and "camera_name" in values:
        actual = f"{values['camera_name']!r} without a camera file"
        yield Problem("settings", "camera_name", actual, "--camera as well")
    if "camera" not in values and values.get("camera_unit", "m") != "m":
        actual = f"{values['camera_unit']!r} without a camera file"
        yield Problem("settings", "camera_unit", actual, "--camera as well")
    if "camera" not in values and "hfov_deg" in values and "image_size_px" not in values:
        expected = "the size of the video, such as 1920x1080, together with --hfov-deg"
        yield Problem("settings", "image_size_px", "nothing", expected)


def _other_method_problems(values: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield problems with settings that the chosen method does not read.

    The values were read from a file and are not validated, so the method may be of any type.
    """
    method = values.get("method", SETTINGS["method"].default)
    for name, value in values.items():
        info = SETTINGS.get(name)
        if info is None or value == info.default:
            continue
        owner = info.option.method
        if isinstance(method, str) and method in DEFAULT_SKELETONS and owner not in (None, method):
            actual = f"{info.plain(value)!r} with the {method} method, which does not read it"
            yield Problem("settings", name, actual, f"nothing, or --set method={owner} as well")
