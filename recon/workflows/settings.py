"""All settings of a fit: the one table that config.toml, the report and the command line's options are made of.

A setting is one field of `FitSettings` with its `Setting`. Nothing slow is imported here: the command line reads the
table whenever it starts.
"""

from __future__ import annotations

import dataclasses
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from recon.base import files
from recon.base.documents import read_toml
from recon.base.errors import InputError, Problem

if TYPE_CHECKING:
    from recon.fit import TrajectoryOptions

Method = Literal["trajectory", "frame"]
Unit = Literal["m", "cm", "mm"]
UNITS_M: dict[Unit, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
DEFAULT_SKELETONS: dict[Method, str] = {"trajectory": "cheetah-24", "frame": "cheetah-8u"}
"""By method."""
METHODS = {"frame": "recon.thesis"}
"""By the name of another method, the package that fits by it. It is imported by its name: no room needs a wing."""
FILE_SUFFIXES = (".toml", ".npz", ".csv")
"""What ends so is no name of something built in."""
NUMBER = "<number>"
"""Stands for one in the help of the command line."""


# -- kinds of values ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Kind:
    """read: the value from what TOML, an option or a table's cell holds; raises ValueError. option_type: what the
    command line makes of an option before that; metavar: how its help calls it, if not by that type. many: the value is
    a tuple, one for each camera of the clip, and an option may be given several times. expected: ends the sentence
    "expected ..." of an error message, where all settings of the kind expect the same."""

    read: Callable[[Any], Any]
    metavar: str | None = None
    option_type: type = str
    many: bool = False
    expected: str = ""

    def plain(self, value: Any) -> Any:
        """The value as TOML and JSON have it; a single one of many by itself."""
        if self.many and value is not None:
            values = [str(one) if isinstance(one, Path) else one for one in value]
            return values[0] if len(values) == 1 else values
        return str(value) if isinstance(value, Path) else list(value) if isinstance(value, tuple) else value


def _each(kind: Kind) -> Kind:
    """One or several of a kind."""

    def read(given: Any) -> tuple[Any, ...]:
        values = given if isinstance(given, list | tuple) else [given]
        if not values:
            raise ValueError(given)
        return tuple(kind.read(one) for one in values)

    return Kind(read, kind.metavar, kind.option_type, many=True)


def _number(fits: Callable[[float], bool]) -> Kind:
    """A finite number, also as text."""

    def read(given: Any) -> float:
        number = math.nan if isinstance(given, bool) or not isinstance(given, int | float | str) else float(given)
        if not math.isfinite(number) or not fits(number):
            raise ValueError(given)
        return number

    return Kind(read, NUMBER)


def _count(given: Any) -> int:
    number = _POSITIVE.read(given)
    if not number.is_integer():
        raise ValueError(given)
    return int(number)


def _one_of(*words: str) -> Kind:
    def read(given: Any) -> str:
        if given not in words:
            raise ValueError(given)
        return given

    return Kind(read, expected=f"{', '.join(words[:-1])} or {words[-1]}")


def _text(given: Any) -> str:
    if not isinstance(given, str):
        raise ValueError(given)
    return given


def _flag(given: Any) -> bool:
    words = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
    if not isinstance(given, bool) and str(given).lower() not in words:
        raise ValueError(given)
    return given if isinstance(given, bool) else words[str(given).lower()]


def _file(given: Any) -> Path:
    """As an absolute path, so that config.toml can be run again from anywhere."""
    if not isinstance(given, str | Path):
        raise ValueError(given)
    return Path(given).absolute()


def _name_or_file(given: Any) -> str:
    """A file as its absolute path; the name of something built in as it is."""
    name = _text(str(given) if isinstance(given, Path) else given)
    return str(Path(name).absolute()) if name.endswith(FILE_SUFFIXES) else name


def _size(given: Any) -> tuple[int, int]:
    """(width, height), from two numbers or the text "1920x1080"."""
    match = re.fullmatch(r"\s*([0-9]{1,9})\s*[xX]\s*([0-9]{1,9})\s*", given) if isinstance(given, str) else None
    numbers = match.groups() if match else given
    if not isinstance(numbers, tuple | list) or len(numbers) != 2:
        raise ValueError(given)
    return _count(numbers[0]), _count(numbers[1])


def _frames(given: Any) -> str:
    from recon.clip.keypoints import parse_frame_range  # numpy is slow to import

    parse_frame_range(_text(given))
    return given


_POSITIVE = _number(lambda number: number > 0)
_COUNT = Kind(_count, NUMBER)
_TEXT, _NAME_OR_FILE, _FRAMES = Kind(_text), Kind(_name_or_file), Kind(_frames)
_FLAG, _FILE = Kind(_flag, option_type=bool, expected="true or false"), Kind(_file, option_type=Path)


# -- the table ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """What is known of a setting besides its name.

    help: for the command line; where there is no default, it says in brackets what happens instead. expected: see
    `Kind`. default: where it is not given, None for nothing. method: the only one that reads it. is_option: whether the
    command line has it, or config.toml and manifests only.
    """

    kind: Kind
    help: str
    expected: str
    default: Any = None
    method: Method | None = None
    is_option: bool = True


def _field(
    kind: Kind, help: str, expected: str = "", default: Any = None, method: Method | None = None, is_option: bool = True
) -> Any:
    setting = Setting(kind, help, expected or kind.expected, default, method, is_option)
    return dataclasses.field(default=None if method else default, metadata={"setting": setting})


@dataclass(frozen=True)
class FitSettings:
    """What `recon fit` is told. Raises InputError with everything that is wrong with it.

    One of camera (a calibration file) and hfov_deg with image_size_px is needed. None: not given, so that a setting has
    its default, and those that only the other method reads stay None. Text is taken for numbers, sizes and files.
    Fields without a unit in their name are counts, names or shares; the solvers' are explained at
    `recon.fit.TrajectoryOptions` and by the packages of the other methods.
    """

    keypoints: tuple[Path, ...] = _field(
        _each(_FILE),
        "Keypoint file, as in clip.csv: DeepLabCut, SLEAP, movement, NWB, COCO or a plain table. Of a clip that "
        "several cameras filmed, one file for each of them.",
        "a keypoint file, as of DeepLabCut or SLEAP, or a list of them, one for each camera",
        default=MISSING,
    )
    camera: Path | None = _field(  # noqa: RUF009
        _FILE, "Calibration: OpenCV yaml/json/xml, AcinoSet scene.json, Anipose or recon toml.", "a camera file"
    )
    camera_name: tuple[str, ...] | None = _field(
        _each(_TEXT),
        "Which camera of the file, by name or number, as in cam2 or 2; with several keypoint files once for each, in "
        "their order. (default: the one whose name the keypoint file's name contains)",
        "the name or number of a camera in the camera file, as text; with several keypoint files one for each",
    )
    camera_unit: Unit = _field(  # noqa: RUF009
        _one_of(*UNITS_M),
        "Unit of the places of cameras in the calibration file: m, cm or mm, as Anipose's often are.",
        default="m",
    )
    camera_track: tuple[Path, ...] | None = _field(
        _each(_FILE),
        "Where a camera that moves was in each frame: a CSV table or a COLMAP text model, once for each such camera. "
        "With several keypoint files it is that of the camera whose name its own name contains. "
        "(default: cameras stand still)",
        "a CSV table of poses, or a COLMAP text model, one for each camera that moves",
        method="trajectory",
    )
    offset_s: tuple[float, ...] | None = _field(
        _each(_number(lambda number: True)),
        "How much later a camera began to film than the first, in seconds, as in 0.025 or -1.5; once for each keypoint "
        "file, in their order. (default: all began together)",
        "seconds, as in 0.025 or -1.5, one for each keypoint file",
        method="trajectory",
    )
    find_offsets: bool | None = _field(
        _FLAG,
        "Find how much later than the first each camera began to film, from the animal's motion; --offset-s is where "
        "the search begins.",
        default=False,
        method="trajectory",
    )
    refine_cameras: bool | None = _field(
        _FLAG,
        "Take the poses of all cameras but the first for as good as 2 degrees and 5 cm, and find them with the fit; "
        "the refined cameras go into cameras.toml.",
        default=False,
        method="trajectory",
    )
    focal_sigma: float | None = _field(
        _POSITIVE,
        "How well the cameras' focal lengths are known, relative, as in 0.1; of several cameras they are found with "
        "the fit and go into cameras.toml. (default: exactly)",
        "a share of the focal length above 0, as in 0.1",
        method="trajectory",
    )
    camera_fps: tuple[float, ...] | None = _field(
        _each(_POSITIVE),
        "Frame rates of cameras that differ in it, once for each keypoint file, as in 120 and 59.94. The result has "
        "the first one's. (default: all have the same)",
        "frames per second above 0, one number for each keypoint file",
        method="trajectory",
    )
    fps: float | None = _field(
        _POSITIVE,
        "Frame rate of the video in Hz, as in 120. (default: what the file says, if it does)",
        "a number of frames per second above 0, as in 120",
    )
    method: Method = _field(  # noqa: RUF009
        _one_of("trajectory", "frame"),
        "trajectory: the whole animal over the whole clip; frame: one side, one frame after the other.",
        default="trajectory",
    )
    skeleton: str | None = _field(
        _NAME_OR_FILE,
        "Name of a built-in skeleton or a TOML file. (default: cheetah-24; cheetah-8u for the frame method)",
        "the name of a built-in skeleton, or a TOML file",
    )
    subject: str | None = _field(
        _NAME_OR_FILE,
        "Lengths measured on one animal: built-in name or TOML file, as in jules. (default: the skeleton's)",
        "the name of a built-in subject, or a TOML file with one animal's lengths",
        method="trajectory",
    )
    detector: str | None = _field(
        _NAME_OR_FILE,
        "Where the detector's keypoints lie beside the markers: a built-in name, as in acinoset, a TOML file, or none. "
        "(default: as the subject's or the skeleton's file says)",
        "the name of a built-in detector, a file that `recon subject fit` wrote, or none",
        method="trajectory",
    )
    prior: str | None = _field(
        _NAME_OR_FILE,
        "What motions are like: a built-in name, a file of `recon prior fit`, or none. "
        "(default: the built-in one for this skeleton, if any)",
        "the name of a built-in prior, a file that `recon prior fit` wrote, or none",
        method="trajectory",
    )
    hfov_deg: float | None = _field(
        _number(lambda number: 0 < number < 180),
        "Without a calibration: horizontal field of view in degrees, as in 64.",
        "a field of view in degrees, above 0 and below 180",
    )
    image_size_px: tuple[int, int] | None = _field(
        Kind(_size),
        "Size of the video in pixels, if the camera file lacks it, as in 1920x1080.",
        "width x height in pixels, as in 1920x1080",
    )
    tilt_deg: float | None = _field(
        _number(lambda number: -90 < number < 90),
        "Without extrinsics: how far the camera looks down, in degrees, as in 5. (default: level)",
        "degrees that the camera looks down, above -90 and below 90, as in 5",
    )
    individual: str | None = _field(
        _TEXT, "Which animal of a multi-animal file, as in animal1.", "the name of an animal in the keypoint file"
    )
    rename: str | None = _field(
        _NAME_OR_FILE,
        "New names of the keypoints: a CSV file with two columns, old name and new one, or a built-in map, as in "
        "superanimal-quadruped. (default: the file's names)",
        "the name of a built-in map of names, or a CSV file with two columns",
    )
    frames: str | None = _field(
        _FRAMES,
        "Only these frame numbers, from A up to but without B, as in 100:160.",
        "frame numbers A:B with A < B, from A up to but without B, as in 100:160",
    )
    likelihood_min: float = _field(
        _number(lambda number: 0 <= number <= 1),
        "Leave out points less likely than this, 0 to 1.",
        "a number from 0 to 1",
        default=0.5,
    )
    side: Literal["auto", "left", "right"] = _field(
        _one_of("auto", "left", "right"),
        "With a skeleton of one side, which to fit: auto, left or right.",
        default="auto",
    )
    ground: Literal["auto", "none"] | None = _field(
        _one_of("auto", "none"),
        "auto: feet that stand are still and on one plane; none: nothing is said about them.",
        default="auto",
        method="trajectory",
    )
    size_sigma: float | None = _field(
        _POSITIVE,
        "Standard deviation of the animal's size, relative, as in 0.1. (default: the skeleton's)",
        "a share of the size above 0, as in 0.1",
        method="trajectory",
    )
    fast: bool | None = _field(_FLAG, "Quicker: fewer directions to start from.", default=False, method="trajectory")
    fix_swaps: bool | None = _field(
        _FLAG,
        "Exchange left and right back where they look exchanged, and fit again.",
        default=False,
        method="trajectory",
    )
    form: Literal["deadband", "printed"] | None = _field(
        _one_of("deadband", "printed"),
        "Ranges and rates: deadband (beyond the limit) or printed (two-sided).",
        default="deadband",
        method="frame",
    )
    angle_prior: Literal["gaussian", "none"] | None = _field(
        _one_of("gaussian", "none"),
        "Gaussian priors on angles and heading: gaussian or none.",
        default="gaussian",
        method="frame",
    )
    camera_rotation: Literal["free", "fixed"] | None = _field(
        _one_of("free", "fixed"),
        "The body's rotation: free, or fixed to the first frame's.",
        default="free",
        method="frame",
    )
    base_length_m: float | None = _field(
        _POSITIVE,
        "Base length of the chain in metres, as in 0.203. (default: the skeleton's)",
        "metres above 0, as in 0.203",
        method="frame",
    )
    base_sigma_m: float | None = _field(
        _POSITIVE,
        "Standard deviation of the base length in metres, as in 0.001. (default: the skeleton's)",
        "metres above 0, as in 0.001",
        method="frame",
    )
    sigma_px: float = _field(
        _POSITIVE, "Noise of the detector in pixels, one standard deviation.", "pixels above 0, as in 3", default=3.0
    )
    keypoint_sigma_m: float | None = _field(
        _number(lambda number: number >= 0),
        "How far keypoints lie from the joints, metres, as in 0.05. (default: the skeleton's)",
        "metres, 0 or more, as in 0.05",
    )
    keypoint_sigma_max_px: float | None = _field(
        _POSITIVE,
        "The most that keypoint_sigma_m may be in the picture, pixels.",
        "pixels above 0, as in 12",
        default=12.0,
        method="frame",
        is_option=False,
    )
    robust_c: float | None = _field(
        _POSITIVE,
        "Residuals of this many standard deviations count half.",
        "a number above 0, as in 4.5",
        default=4.5,
        method="frame",
        is_option=False,
    )
    tolerance: float | None = _field(
        _POSITIVE,
        "When the optimiser stops.",
        "a number above 0, as in 1e-8",
        default=1e-8,
        method="frame",
        is_option=False,
    )
    max_evaluations: int | None = _field(
        _COUNT,
        "How often the optimiser may evaluate a frame.",
        "a whole number above 0, as in 400",
        default=400,
        method="frame",
        is_option=False,
    )

    def __post_init__(self) -> None:
        given = {name: value for name in SETTINGS if (value := getattr(self, name)) is not None}
        problems = []
        for name, setting in SETTINGS.items():
            if name in given:
                try:
                    object.__setattr__(self, name, setting.kind.read(given[name]))
                except (ValueError, OverflowError):
                    problems.append(Problem("settings", name, repr(given[name]), setting.expected))
            elif setting.default is MISSING:
                problems.append(Problem("settings", name, "nothing", setting.expected))
            elif setting.method in (None, self.method):
                object.__setattr__(self, name, setting.default)
        problems += _camera_problems(given)
        if not problems:
            problems += self._problems_of_several()
        problems += _of_the_other_method(self.method, given)
        if problems:
            raise InputError(problems)

    def _problems_of_several(self) -> Iterator[Problem]:
        """Where a clip has several cameras, everything of one camera is there once for each."""
        count = len(self.keypoints)
        for name in ("camera_name", "offset_s", "camera_fps"):
            values = getattr(self, name)
            if values is not None and len(values) != count:
                expected = f"one for each keypoint file, that is {count}"
                yield Problem("settings", name, f"{len(values)}: {', '.join(map(str, values))}", expected)
        for name in ("find_offsets", "refine_cameras", "focal_sigma"):
            if getattr(self, name) and count == 1:
                yield Problem("settings", name, "one keypoint file", "files of several cameras")
            if getattr(self, name) and name != "find_offsets" and self.camera_track is not None:
                yield Problem("settings", name, "beside a camera track", "cameras that stand still")
        if self.camera_fps is not None and self.fps is not None:
            yield Problem("settings", "camera_fps", f"beside fps, {self.fps:g}", "one of the two")
        if count > 1 and self.method == "frame":
            found = f"{count} files with the frame method, which knows one camera"
            yield Problem("settings", "keypoints", found, "one file, or --method trajectory")
        named_tracks = self.camera_track is not None and self.camera_name is not None and self.hfov_deg is None
        if count > 1 and self.camera is None and not named_tracks:
            found = f"{count} keypoint files without a camera file"
            yield Problem("settings", "camera", found, "a calibration of all these cameras")
        if len(self.camera_track or ()) > count:
            found = f"{len(self.camera_track or ())} for {count} keypoint file{'s' * (count > 1)}"
            yield Problem("settings", "camera_track", found, "one for each camera that moves")
        if len(set(self.keypoints)) < count:
            found = ", ".join(str(path) for path in self.keypoints)
            yield Problem("settings", "keypoints", found, "a different file for each camera")

    @property
    def keypoints_text(self) -> str:
        """The keypoint files in one line."""
        return ", ".join(str(path) for path in self.keypoints)

    def keypoints_from(self, folder: Path) -> list[str]:
        """The same, each as seen from a folder."""
        return seen_from(folder, "keypoints", [str(path) for path in self.keypoints])

    @property
    def skeleton_name(self) -> str:
        """As given, or the method's default."""
        return DEFAULT_SKELETONS[self.method] if self.skeleton is None else self.skeleton

    @property
    def seeks_cameras(self) -> bool:
        """Whether cameras come out otherwise than their file says."""
        return bool(self.refine_cameras) or self.focal_sigma is not None

    def trajectory_options(self) -> TrajectoryOptions:
        from recon.fit import TrajectoryOptions

        names = ("fast", "ground", "sigma_px", "keypoint_sigma_m", "size_sigma")
        names += ("find_offsets", "refine_cameras", "focal_sigma")
        return TrajectoryOptions(**{name: getattr(self, name) for name in names})

    def plain(self, folder: Path | None = None) -> dict[str, Any]:
        """All that the method reads, as plain JSON types; None for what is not given and has no default. folder: that
        paths are relative to, as `beside` reads them; None: they are absolute."""
        values = {name: getattr(self, name) for name, it in SETTINGS.items() if it.method in (None, self.method)}
        plain = {name: SETTINGS[name].kind.plain(value) for name, value in values.items()}
        return plain if folder is None else {name: seen_from(folder, name, value) for name, value in plain.items()}

    def to_toml(self, folder: Path | None = None, sha256: Mapping[str, str] | None = None) -> str:
        """The text of config.toml. Settings that are not given are left out; folder: see `plain`; sha256: what is
        written down of the files' content."""
        import tomli_w

        plain = {name: value for name, value in self.plain(folder).items() if value is not None}
        return tomli_w.dumps({"recon": {"fit": plain, **({"sha256": sha256} if sha256 else {})}})


SETTINGS: dict[str, Setting] = {one.name: one.metadata["setting"] for one in dataclasses.fields(FitSettings)}
"""By name, in the order of `FitSettings`."""


def beside(folder: Path, name: str, given: Any) -> Any:
    """The value of a setting that stands in a file of that folder: its paths are relative to the folder."""
    return _with_paths(name, given, lambda path: os.path.normpath(folder.absolute() / path))


def seen_from(folder: Path, name: str, given: Any) -> Any:
    """The value as it has to stand in a file of that folder, see `files.seen_from`."""
    return _with_paths(name, given, lambda path: files.seen_from(folder, path))


def _with_paths(name: str, given: Any, change: Callable[[str], str]) -> Any:
    if isinstance(given, list):
        return [_with_paths(name, one, change) for one in given]
    kind = SETTINGS[name].kind if name in SETTINGS else None
    is_file = kind is not None and (
        kind.option_type is Path or (kind is _NAME_OR_FILE and str(given).endswith(FILE_SUFFIXES))
    )
    return change(given) if is_file and isinstance(given, str) else given


def of_method(method: Method) -> tuple[str, ...]:
    """Names of the settings that only this method reads."""
    return tuple(name for name, setting in SETTINGS.items() if setting.method == method)


def _camera_problems(given: Mapping[str, Any]) -> Iterator[Problem]:
    """A camera is given in one way, with what belongs to it."""
    if not given.keys() & {"camera", "hfov_deg", "camera_track"}:
        expected = "a camera file, or --hfov-deg with --image-size for a rough one"
        yield Problem("settings", "camera", "nothing", expected)
    if "camera" in given and "hfov_deg" in given:
        yield Problem("settings", "hfov_deg", f"{given['hfov_deg']} beside a camera file", "one of the two")
    if "camera_track" in given and "tilt_deg" in given:
        found = f"{given['tilt_deg']} beside a camera track, which says which way is up"
        yield Problem("settings", "tilt_deg", found, "one of the two")
    if not given.keys() & {"camera", "camera_track"} and "camera_name" in given:
        found = f"{given['camera_name']!r} without a camera file"
        yield Problem("settings", "camera_name", found, "--camera with it")
    if "camera" not in given and given.get("camera_unit", "m") != "m":
        found = f"{given['camera_unit']!r} without a camera file"
        yield Problem("settings", "camera_unit", found, "--camera with it")
    if "camera" not in given and "hfov_deg" in given and "image_size_px" not in given:
        expected = "the size of the video beside --hfov-deg, as in 1920x1080"
        yield Problem("settings", "image_size_px", "nothing", expected)


def _of_the_other_method(method: Any, given: Mapping[str, Any]) -> Iterator[Problem]:
    """What would have no effect. The method may be none, such as a list in a file."""
    for name, value in given.items():
        other = SETTINGS[name].method
        if isinstance(method, str) and method in DEFAULT_SKELETONS and other not in (None, method):
            found = f"{value!r} with the {method} method, which does not read it"
            yield Problem("settings", name, found, f"nothing, or --method {other} with it")


# -- from config.toml and the command line ------------------------------------------------------------------------


def read_settings(config: Path | None, given: Mapping[str, Any] | None = None) -> FitSettings:
    """Settings from the table [recon.fit] of a TOML file, such as config.toml, overruled by those given.

    None is not given. Paths in the file are relative to its folder. Another camera or method among those given replaces
    the one of the file together with all that belongs to it. Raises InputError, naming every setting that is wrong, and
    where it was given.
    """
    given = {name: value for name, value in (given or {}).items() if value is not None}
    under = {} if config is None else _read_config(config)
    left_out = set(given)
    if "camera" in given:
        left_out |= {"hfov_deg", "image_size_px", "camera_name", "camera_unit", "tilt_deg"}
    if "hfov_deg" in given:
        left_out |= {"camera", "camera_name", "camera_unit"}
    if "camera_track" in given:
        left_out |= {"tilt_deg"}
    before = under.get("method", SETTINGS["method"].default)
    if given.get("method", before) != before:
        left_out |= {name for name, setting in SETTINGS.items() if setting.method == before}
    plain = {name: value for name, value in under.items() if name not in left_out} | given

    known: dict[str, Any] = {"keypoints": None} | {name: plain[name] for name in plain if name in SETTINGS}
    unknown = [name for name in plain if name not in SETTINGS]
    problems = []
    try:
        settings = FitSettings(**known)
        if not unknown:
            return settings
    except InputError as error:
        problems += error.problems
    problems += [Problem("settings", name, "an unknown setting", f"one of {', '.join(SETTINGS)}") for name in unknown]
    raise InputError(
        dataclasses.replace(
            problem, file=config if config is not None and problem.field not in given else option(problem.field)
        )
        for problem in problems
    )


def option(name: str) -> str:
    """The command line's name for a setting."""
    return {"keypoints": "KEYPOINTS", "image_size_px": "--image-size"}.get(name, "--" + name.replace("_", "-"))


def _read_config(config: Path) -> dict[str, Any]:
    document = read_toml(config, "a config.toml of an earlier run")
    table = document.get("recon", {})
    table = table.get("fit") if isinstance(table, dict) else None
    if not isinstance(table, dict):
        raise InputError(Problem(config, "table", ", ".join(document)[:120] or "nothing", "[recon.fit]"))
    return {name: beside(config.parent, name, value) for name, value in table.items()}
