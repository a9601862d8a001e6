"""Test the settings that the command line and config.toml accept, and the messages about wrong settings."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import MISSING, replace
from pathlib import Path

import numpy as np
import pytest
from command_line import refusal, refused, run
from rich.text import Text

from recon import FitSettings, InputError, read_settings, samples_folder
from recon.animal.skeleton_file import load_skeleton
from recon.api.clip_inputs import read_model_and_cameras
from recon.api.settings import SETTINGS
from recon.cli.app import app, commands
from recon.cli.look_options import OverlaySettings, PageSettings
from recon.fit.clip_problem import TrajectoryOptions
from recon.io.calibration import read_camera, read_cameras
from recon.thesis.objectives import FrameOptions

GIVEN = {"keypoints": Path("/data/clip.csv"), "camera": Path("/data/camera.toml"), "fps": 30.0}


def of_method(method: str) -> list[str]:
    """Return the names of the settings that only the given method reads."""
    return [name for name, setting in SETTINGS.items() if setting.option.method == method]


def test_the_help_of_a_setting_is_about_that_setting():
    for name, word in (
        ("initial_damping", "damping"),
        ("damping_factor", "damping"),
        ("keypoint_sigma_m", "keypoints"),
    ):
        assert word in SETTINGS[name].option.help


def refuses(given: dict, *expected: tuple[object, ...], config: Path | None = None) -> None:
    """Check that settings are refused for the expected problems, whose file is the option or the config."""
    with refusal(*((config or SETTINGS[str(one[0])].on_command_line, *one) for one in expected)):
        read_settings(config, given)


def write_config(folder: Path, text: str) -> Path:
    path = folder / "config.toml"
    path.write_text(text, encoding="utf-8")
    return path


def saved(folder: Path, **given) -> Path:
    return write_config(folder, FitSettings(**{**GIVEN, **given}).to_toml())


def test_settings_not_given_have_their_defaults():
    settings = read_settings(None, {**GIVEN, "side": None, "likelihood_min": None})
    assert settings.side == "auto"
    assert settings.likelihood_min == 0.5
    assert FrameOptions.from_settings(FitSettings(**GIVEN, method="frame").plain()) == FrameOptions()
    assert settings.trajectory_options() == TrajectoryOptions(focal_sigma=0.02)
    assert (settings.method, settings.skeleton_name) == ("trajectory", "cheetah-24")


def test_each_method_has_its_default_skeleton():
    assert FitSettings(**GIVEN, method="frame").skeleton_name == "cheetah-8u"
    assert FitSettings(**GIVEN, method="frame", skeleton="mine").skeleton_name == "mine"


def test_options_of_the_trajectory_method():
    changed = {"fast": True, "ground": "none", "sigma_px": 2.5, "keypoint_sigma_m": 0.04, "size_sigma": 0.02}
    assert FitSettings(**GIVEN, **changed).trajectory_options() == TrajectoryOptions(focal_sigma=0.02, **changed)


def test_every_solver_option_is_a_setting():
    changed = {
        "form": "printed",
        "reprojection": "printed",
        "angle_prior": "none",
        "camera_rotation": "fixed",
        "path": "free",
        "path_sigma_m": 0.1,
        "start_angles": "th6=55",
        "initial_damping": 0.01,
        "damping_factor": 5.0,
        "base_length_m": 0.21,
        "base_sigma_m": 0.001,
        "sigma_px": 2.5,
        "keypoint_sigma_m": 0.04,
    }
    assert set(changed) == {*FrameOptions.__dataclass_fields__} & {*SETTINGS}
    assert {*of_method("frame")} < {*changed}
    assert FrameOptions.from_settings(FitSettings(**GIVEN, **changed, method="frame").plain()) == FrameOptions(
        **changed
    )


@pytest.mark.parametrize(
    "given",
    [
        GIVEN,
        {
            **GIVEN,
            "camera_name": "cam2",
            "frames": "3:9",
            "individual": "a",
            "fps": 29.97,
            "keypoint_sigma_m": 0.1 + 0.2,
        },
        {"keypoints": Path("/c.csv"), "fps": 120.0, "hfov_deg": 63.7, "image_size_px": "1920x1080"},
    ],
)
def test_config_reads_back_as_it_was(tmp_path, given):
    settings = read_settings(None, given)
    assert read_settings(write_config(tmp_path, settings.to_toml()), {}) == settings


def test_paths_in_a_config_are_relative_to_it(tmp_path, monkeypatch):
    """Paths in a config are relative to its folder, and names of built-in files stay as they are."""
    (tmp_path / "cats").mkdir()
    config = write_config(
        tmp_path / "cats",
        '[recon.fit]\nkeypoints = ["a_cam1.csv", "/data/a_cam2.csv"]\ncamera = "scene.json"\n'
        'skeleton = "cat.toml"\nsubject = "jules"\nprior = "cat.npz"\nfps = 60\n',
    )
    monkeypatch.chdir(tmp_path)
    settings = read_settings(Path("cats") / config.name)
    assert settings.keypoints == (tmp_path / "cats" / "a_cam1.csv", Path("/data/a_cam2.csv"))
    assert settings.camera == (tmp_path / "cats" / "scene.json",)
    assert (settings.skeleton, settings.subject) == (str(tmp_path / "cats" / "cat.toml"), "jules")
    assert settings.prior == str(tmp_path / "cats" / "cat.npz")


def test_config_holds_every_setting_that_has_a_value():
    plain = tomllib.loads(FitSettings(**GIVEN).to_toml())["recon"]["fit"]
    unset = {"camera_name", "hfov_deg", "image_size_px", "tilt_deg", "individual", "frames", "skeleton", "subject"}
    unset |= {"rename", "camera_track", "offset_s", "camera_fps", "focal_sigma", "prior", "detector"}
    unset |= {"lens", "up", "size", "size_sigma", "height_m", "keypoint_sigma_m", "belt_speed_m_s", "corrections"}
    assert set(plain) == set(SETTINGS) - unset - set(of_method("frame"))
    assert plain["keypoints"] == "/data/clip.csv"


def test_paths_become_absolute(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = {"skeleton": "mine.toml", "subject": "my-cat.toml", "prior": "cats.npz"}
    settings = FitSettings(keypoints="a/clip.csv", camera="camera.toml", fps=30, **given)  # pyright: ignore[reportArgumentType]
    assert settings.keypoints == (tmp_path / "a" / "clip.csv",)
    assert settings.camera == (tmp_path / "camera.toml",)
    assert settings.skeleton == str(tmp_path / "mine.toml")
    assert settings.subject == str(tmp_path / "my-cat.toml")
    assert settings.prior == str(tmp_path / "cats.npz")
    assert FitSettings(**GIVEN, subject="jules", prior="none").subject == "jules"


@pytest.mark.parametrize("size", ["1920x1080", "1920X1080", " 1920 x 1080 ", [1920, 1080], (1920, 1080)])
def test_image_size_as_text_or_as_numbers(size):
    assert FitSettings(**GIVEN, image_size_px=size).image_size_px == (1920, 1080)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("fps", 0.0, "greater than 0"),
        ("fps", "90fps", "number"),
        ("fps", True, "number"),
        ("fps", -5.0, "greater than 0"),
        ("fps", float("nan"), "number"),
        ("fps", float("inf"), "number"),
        ("likelihood_min", 2.0, "0 to 1"),
        ("likelihood_min", float("nan"), "0 to 1"),
        ("side", "up", "auto, left or right"),
        ("form", "soft", "deadband or printed"),
        ("method", "window", "trajectory or frame"),
        ("ground", "flat", "auto or none"),
        ("size_sigma", 0.0, "greater than 0"),
        ("tilt_deg", 90.5, "or equal to 90"),
        ("fast", "very", "true or false"),
        ("angle_prior", "flat", "gaussian or none"),
        ("camera_rotation", "still", "free or fixed"),
        ("base_length_m", 0.0, "greater than 0"),
        ("base_sigma_m", -1.0, "greater than 0"),
        ("sigma_px", 0.0, "greater than 0"),
        ("keypoint_sigma_m", -1.0, "or equal to 0"),
        ("keypoint_sigma_m", float("inf"), "number"),
        ("image_size_px", "1920", "1920x1080"),
        ("image_size_px", "0x0", "1920x1080"),
        ("image_size_px", "1x2x3", "1920x1080"),
        ("frames", "9", "A < B"),
        ("frames", "9:3", "A < B"),
        ("frames", "a:b", "A < B"),
    ],
)
def test_wrong_value_is_named_in_plain_words(name, value, expected):
    method = {"method": "frame"} if name in of_method("frame") else {}
    refuses({**GIVEN, **method, name: value}, (name, repr(value), expected))


ROUGH = {"keypoints": Path("c.csv"), "fps": 30.0, "hfov_deg": 60.0, "image_size_px": "1920x1080"}


@pytest.mark.parametrize(
    ("degrees", "expected"), [(0.0, "greater than 0"), (180.0, "less than 180"), (float("nan"), "number")]
)
def test_field_of_view_lies_between_0_and_180(degrees, expected):
    refuses(ROUGH | {"hfov_deg": degrees}, ("hfov_deg", degrees, expected))


@pytest.mark.parametrize("given", ["64+-6", "64 ± 6", "64.0+/-6"])
def test_field_of_view_has_an_uncertainty(given):
    settings = FitSettings(keypoints=(Path("c.csv"),), fps=30.0, hfov_deg=given, image_size_px="1920x1080")
    assert settings.hfov_deg == 64.0
    focal = [1 / np.tan(np.radians(degrees) / 2) for degrees in (63.9, 64.1)]
    assert settings.focal_sigma == pytest.approx(6 * abs(np.log(focal[1] / focal[0])) / 0.2, rel=1e-3)
    refuses(ROUGH | {"hfov_deg": "264+-6"}, ("hfov_deg", "'264+-6'", "less than 180"))


def test_uncertainty_of_the_field_of_view_of_a_fisheye_lens():
    """The focal length of an equidistant lens is inversely proportional to its field of view."""
    assert FitSettings(**ROUGH | {"hfov_deg": "118+-6", "lens": "fisheye"}).focal_sigma == pytest.approx(6 / 118)


def test_uncertainty_of_the_focal_length_depends_on_the_camera(tmp_path):
    clip = {"keypoints": (Path("c.csv"),), "fps": 30.0}
    calibrated = FitSettings(**clip, camera=tmp_path / "camera.toml").trajectory_options()
    stated = FitSettings(**clip, hfov_deg=64.0, image_size_px="1920x1080").trajectory_options()
    two = FitSettings(keypoints=(Path("a.csv"), Path("b.csv")), camera=tmp_path / "camera.toml", fps=30.0)
    assert (calibrated.focal_sigma, stated.focal_sigma) == (0.02, 0.1)
    assert two.trajectory_options().focal_sigma is None


def test_every_wrong_setting_is_named_at_once():
    given = {"fps": 0.0, "side": "up", "frames": "9:3", "image_size_px": "big", "camera_name": "cam2"}
    missing = [("keypoints", "nothing"), ("camera", "nothing")]
    refuses(given, *missing, *((name, value if name == "fps" else repr(value)) for name, value in given.items()))


def test_messages_do_not_repeat_pydantic():
    with pytest.raises(InputError) as caught:
        read_settings(None, dict.fromkeys(SETTINGS, object()))
    found = caught.value.problems
    assert {problem.file for problem in found} == {info.on_command_line for info in SETTINGS.values()}
    assert not [problem for problem in found if "Input" in str(problem) or "valid" in str(problem)]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"keypoints": Path("c.csv"), "fps": 30.0}, ("camera", "nothing", "--hfov-deg with --image-size")),
        (ROUGH | {"image_size_px": None}, ("image_size_px", "nothing", ["--hfov-deg", "1920x1080"])),
        ({**GIVEN, "hfov_deg": 60.0}, ("hfov_deg", [60.0, "camera file"], "only one of the two")),
        (ROUGH | {"camera_name": "cam2"}, ("camera_name", ["'cam2'", "without"], "--camera")),
        ({**GIVEN, "lens": "fisheye"}, ("lens", ["'fisheye'", "without"], "--hfov-deg")),
    ],
)
def test_settings_that_do_not_go_together(given, expected):
    refuses(given, expected)


@pytest.mark.parametrize(
    ("name", "value", "method"),
    [
        ("form", "printed", "frame"),
        ("angle_prior", "none", "frame"),
        ("camera_rotation", "fixed", "frame"),
        ("base_length_m", 0.2, "frame"),
        ("base_sigma_m", 0.01, "frame"),
        ("subject", "jules", "trajectory"),
        ("prior", "none", "trajectory"),
        ("ground", "none", "trajectory"),
        ("size_sigma", 0.1, "trajectory"),
        ("fast", True, "trajectory"),
    ],
)
def test_options_of_the_other_method_are_refused(tmp_path, name, value, method):
    other = "frame" if method == "trajectory" else "trajectory"
    assert name in of_method(method)
    expected = (name, [repr(value), f"{other} method"], f"--set method={method}")
    refuses({**GIVEN, "method": other, name: value}, expected)
    with refusal(("settings", *expected)):
        FitSettings(**{**GIVEN, "method": other, name: value})
    config = saved(tmp_path, method=other)
    toml_value = str(value).lower() if isinstance(value, bool | int | float) else f'"{value}"'
    config.write_text(f"{config.read_text()}{name} = {toml_value}\n")
    refuses({}, expected, config=config)


@pytest.mark.parametrize(("method", "other"), [("trajectory", "frame"), ("frame", "trajectory")])
def test_config_and_report_hold_no_setting_of_the_other_method(method, other):
    settings = FitSettings(**GIVEN, method=method)
    in_config = tomllib.loads(settings.to_toml())["recon"]["fit"]
    assert not {*in_config, *settings.plain()} & set(of_method(other))
    assert set(settings.plain()) == set(SETTINGS) - set(of_method(other))


def test_another_method_drops_the_settings_of_the_method_in_the_config(tmp_path):
    config = saved(tmp_path, fast=True, subject="jules", sigma_px=2.0)
    settings = read_settings(config, {"method": "frame"})
    assert settings == FitSettings(**GIVEN, method="frame", sigma_px=2.0)
    config.write_text(config.read_text().replace('method = "trajectory"', 'form = "printed"'))
    assert read_settings(config, {"method": "frame"}).form == "printed"
    refuses({"method": "trajectory"}, ("form", ["'printed'", "trajectory method"]), config=config)


def test_every_option_of_the_other_method_is_named():
    refuses({**GIVEN, "form": "printed", "base_length_m": 0.2}, ("form", "'printed'"), ("base_length_m", 0.2))
    refuses({**GIVEN, "method": "frame", "camera_track": [Path("a.csv")]}, ("camera_track", "'a.csv' with the frame"))


def test_command_line_overrules_config(tmp_path):
    config = saved(tmp_path, side="left", frames="0:9")
    settings = read_settings(config, {"fps": 60.0, "side": "right", "frames": None})
    assert (settings.fps, settings.side, settings.frames) == (60.0, "right", "0:9")
    assert settings.camera == (Path("/data/camera.toml"),)


def test_another_camera_replaces_the_camera_of_the_config(tmp_path):
    config = saved(tmp_path, camera_name="cam2", image_size_px=(1920, 1080), tilt_deg=5)
    other = read_settings(config, {"camera": Path("/other.json")})
    assert (other.camera, other.camera_name, other.image_size_px) == ((Path("/other.json"),), None, None)
    assert other.tilt_deg is None
    rough = read_settings(config, {"hfov_deg": 60.0, "lens": "fisheye"})
    assert (rough.camera, rough.camera_name, rough.image_size_px) == (None, None, (1920, 1080))
    again = read_settings(write_config(tmp_path, rough.to_toml()), {"camera": Path("/c.toml")})
    assert (again.camera, again.hfov_deg, again.lens, again.image_size_px) == ((Path("/c.toml"),), None, None, None)


def test_mistakes_in_a_config_name_the_file(tmp_path):
    config = write_config(tmp_path, '[recon.fit]\nkeypoints = "c.csv"\nfps = "fast"\nspeed = 3\n')
    others = ("speed", "unknown", ", ".join(SETTINGS)), ("camera", "nothing", "--hfov-deg")
    refuses({}, ("fps", "'fast'", "number"), *others, config=config)
    # An error on the command line is attributed to the command line.
    with refusal(("--fps", "fps", 0.0, "greater than 0"), *((config, *other) for other in others)):
        read_settings(config, {"fps": 0.0})


@pytest.mark.parametrize(
    ("text", "field", "found"),
    [
        ("fps = = 3", "content", "Invalid value"),
        ("[other]\nfps = 3", "table", "other"),
        ("", "file", "an empty file"),
        ("recon = 3", "table", "recon"),
        ("[recon]\nfit = 3", "table", "recon"),
    ],
)
def test_broken_config(tmp_path, text, field, found):
    config = write_config(tmp_path, text)
    refuses(GIVEN, (field, found), config=config)


def test_config_that_is_not_text(tmp_path):
    config = tmp_path / "config.toml"
    config.write_bytes(b"\xff\xfe\x00")
    refuses(GIVEN, ("text", "byte 1", ["config.toml", "UTF-8"]), config=config)


def test_method_that_is_a_list(tmp_path):
    config = tmp_path / "config.toml"
    config.write_text('[recon.fit]\nkeypoints = "a.csv"\ncamera = "c.toml"\nmethod = ["frame"]\n')
    refuses({}, ("method", "['frame']", "trajectory or frame"), config=config)


def test_missing_config(tmp_path):
    refuses(GIVEN, ("file", "no such file", "config.toml"), config=tmp_path / "no.toml")


def options_in_help(name: str) -> dict[str, str]:
    return {parameter.opts[0]: parameter.help for parameter in commands()[name].params}  # type: ignore[attr-defined]


def test_help_of_fit_lists_the_common_settings():
    options = {f"--{name}" for name in ("out", "config", "overwrite", "set", "json", "quiet")}
    common = {"keypoints" if it.option.argument else it.on_command_line for it in SETTINGS.values() if it.option.common}
    assert {*options_in_help("fit")} == options | common
    assert len(options | common) + 1 <= 25  # and --help
    assert common - {"keypoints", "--corrections"} <= {*options_in_help("batch")}


def test_help_of_an_option_is_the_help_of_its_setting():
    helps = {parameter.name: parameter.help for parameter in commands()["fit"].params}  # type: ignore[attr-defined]
    assert all(helps[name].startswith(it.option.help) for name, it in SETTINGS.items() if it.option.common)
    assert helps["camera_unit"].endswith("for Anipose. (default: m)")


def test_every_setting_is_listed():
    ended = run("settings", "--json")
    assert [row["name"] for row in json.loads(ended.out)][: len(SETTINGS)] == [*SETTINGS]
    assert "--set sigma-px" in run("settings", "fit").out
    refused(["settings", "fitt"], ("COMMAND", "command", "'fitt'", "fit, batch"))


def test_settings_without_an_option_are_in_the_docs():
    """docs/commands.md lists every setting without an option, whose help and default `recon settings` prints."""
    text = (Path(__file__).parents[1] / "docs" / "commands.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"`([a-z-]+)`", text.partition("## Settings without an option")[2]))
    for info in SETTINGS.values():
        if not info.option.common and info.option.method != "frame":
            assert info.field.replace("_", "-") in listed, info.field


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--size-sigma", "0.1"), ("--size-sigma", "size_sigma", "no option", "--set size-sigma=VALUE")),
        (("--size-sigma=0.1",), ("--size-sigma", "size_sigma", "no option", "--set size-sigma=VALUE")),
        (("--framerate", "60"), ("--framerate", "fps", "no option", "--fps")),
        (("--method", "frame"), ("--method", "method", "no option", "recon frame")),
        (("--no-fast",), ("--no-fast", "fast", "no option", "--set fast=VALUE")),
        (("--set", "sigma"), ("--set", "setting", "'sigma'", "name=value")),
        (("--set", "sigmapx=2"), ("--set", "sigmapx", "unknown", "perhaps sigma_px")),
    ],
)
def test_settings_without_an_option(words, expected):
    refused(["fit", "a.csv", "--camera", "c.toml", "--out", "x", *words], expected)


def test_setting_without_an_option_is_checked():
    files = ("a.csv", "file", "no such file"), ("c.toml", "file", "no such file")
    sigma = "--set sigma-px", "sigma_px", "'0'", "greater than 0"
    height = "--height-m", "height_m", "'1e300'", "less than or equal to 10"  # larger heights overflow
    given = ["fit", "a.csv", "--camera", "c.toml", "--out", "x", "--set", "sigma-px=0", "--height-m", "1e300"]
    refused(given, *files, sigma, height)


def test_a_setting_of_several_values_is_set_several_times(tmp_path):
    files = [samples_folder() / "whole.csv", "--camera", samples_folder() / "camera.toml", "--out", tmp_path / "x"]
    others = ["--fps", "60", "--set", "fast=true", "--no-fix-swaps"]
    refused(
        ["fit", *files, "--set", "offset-s=0", "--set", "offset_s=0.5", *others],
        ("--set offset-s", "offset_s", "2: 0.0, 0.5", "1 value, one for each keypoint file"),
    )


def test_every_command_has_a_help():
    for name, command in commands().items():
        assert command.help, name


def test_help_is_printed_whole():
    """Help is printed whole, also text that looks like markup, such as recon[plots]."""
    for path, command in commands().items():
        texts = [command.help, *(parameter.help for parameter in command.params if hasattr(parameter, "help"))]
        for text in filter(None, texts):
            assert Text.from_markup(text).plain == text, path


@pytest.mark.parametrize(
    "arguments",
    [
        ["convert", "a.csv", "b.csv", "--fps", "90fps"],
        ["overlay", "dir", "--speed", "90fps"],
        ["retarget", "dir", "--rate", "90fps"],
        ["evaluate-2d", "a.csv", "b.csv", "--likelihood-min", "90fps"],
        ["train", "a.mp4", "--minutes", "90fps"],
        ["prior", "fit", "a.csv", "--min-speed-m-s", "90fps"],
    ],
)
def test_options_that_are_numbers(arguments):
    with pytest.raises(InputError) as caught:
        app(arguments)
    problems = {(problem.file, problem.found): problem.expected for problem in caught.value.problems}
    assert (arguments[-2], "'90fps'") in problems
    missing = problems.get(("--video", "nothing"), "")  # optional for `recon report`, whose settings this class extends
    assert missing.startswith("video of the") == (arguments[0] == "overlay")
    assert [of.infos()["video"].default for of in (OverlaySettings, PageSettings)] == [MISSING, None]


def test_each_camera_may_have_its_own_file(tmp_path):
    """Cameras without a unique name get the names of their files."""
    given = (Path(__file__).parents[1] / "data" / "samples" / "camera.toml").read_text()
    for name in ("left", "right"):
        (tmp_path / f"{name}.toml").write_text(given)
    files = tmp_path / "left.toml", tmp_path / "right.toml"
    assert [camera.name for camera in read_cameras(files)] == ["left", "right"]
    assert read_camera(files, "right").name == "right"
    with refusal((", ".join(map(str, files)), "camera", "2 cameras", "left, right")):
        read_camera(files)
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "left.toml").write_text(given)
    with refusal((tmp_path / "more" / "left.toml", "camera", "left")):
        read_cameras((files[0], tmp_path / "more" / "left.toml"))
    settings = read_settings(None, {"keypoints": Path("clip.csv"), "camera": files, "fps": 60.0})
    assert settings.camera == files
    assert settings.plain()["camera"] == [str(file) for file in files]


def test_the_schema_takes_configs_and_names_mistakes(tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads(run("settings", "--schema").out)
    check = jsonschema.Draft202012Validator(schema)
    settings = FitSettings(keypoints="a.csv", camera=("c.toml", "d.toml"), fps=60, frames="3:9", image_size_px="9x8")
    assert list(check.iter_errors(tomllib.loads(settings.to_toml()))) == []
    fit = schema["properties"]["recon"]["properties"]["fit"]["properties"]
    assert fit.keys() == SETTINGS.keys()
    assert all(one["description"] for one in fit.values())
    for wrong in ({"fps": -1}, {"camera_unit": "yards"}, {"speed": 3}, {"fast": 3}):
        assert list(check.iter_errors({"recon": {"fit": wrong}})), wrong


def test_the_height_at_the_withers_is_a_size():
    settings = FitSettings(keypoints="a.csv", hfov_deg=40, image_size_px="9x8", skeleton="horse-22", height_m=1.3)
    (horse, _, _), usual = read_model_and_cameras(settings), load_skeleton("horse-22")
    heights = [body.tree.pose(np.append(np.zeros(4), body.mean_rad)[None]).points_m[0, :, 2] for body in (horse, usual)]
    wither, feet = horse.markers.index("Wither"), [horse.markers.index(foot) for foot in horse.feet]
    assert heights[0][wither] - heights[0][feet].min() == pytest.approx(1.3)
    times = 1.3 / (heights[1][wither] - heights[1][feet].min())
    np.testing.assert_allclose(heights[0], times * heights[1], atol=1e-12)
    assert horse.size_sigma == 0.05
    rough, _, _ = read_model_and_cameras(replace(settings, skeleton="quadruped"))
    assert rough.size_sigma == 0.15  # a skeleton without the proportions of a species
    with refusal(("--height-m", "height_m", ["mouse-top", "no feet"], "--set size")):
        read_model_and_cameras(replace(settings, skeleton="mouse-top"))
    refuses({**GIVEN, "height_m": 1.3, "size": 2.0}, ("height_m", [1.3, "size 2"], "only one of the two"))


def test_every_help_has_an_example_in_a_paragraph_of_its_own():
    without = [name for name, command in commands().items() if "\n\nExample: recon " not in (command.help or "")]
    assert without == []


@pytest.mark.parametrize("value", ["auto", True, False])
def test_a_playback_is_written_for_short_clips_always_or_never(tmp_path, value):
    """`playback` is auto, true or false by option, in config.toml and in Python."""
    text = str(value).lower()
    assert read_settings(None, {**GIVEN, "playback": text}) == FitSettings(**GIVEN, playback=value)
    assert read_settings(saved(tmp_path, playback=value), {}).playback is value
    refuses({**GIVEN, "playback": "maybe"}, ("playback", "'maybe'", "auto, true or false"))
