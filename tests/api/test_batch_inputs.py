"""Test the clips of a batch: files, patterns, folders and manifests, and the cameras of each clip."""

from __future__ import annotations

import csv
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from batches import CAMERA, QUICK, SAMPLES, found, manifest, names, refuses
from command_line import compare, refusal, run, says

from recon import FitSettings, find_clips, plan_batch
from recon.api.batch import COLUMNS, RECORD, Summary, input_problems, read_rows
from recon.api.batch_inputs import is_manifest
from recon.api.clip_results import Record, output_of
from recon.io.calibration import read_cameras

pytestmark = pytest.mark.usefixtures("no_playback", "undrawn", "frames_solved_once")


# Inputs


def test_files_patterns_and_folders_are_clips(clips):
    (clips / "video.mp4").write_bytes(bytes(range(256)))
    (clips / "notes.csv").write_text("day,weather\n1,rain\n")
    assert names(clips / "b.csv", clips / "a.csv") == ["b", "a"]
    assert names(clips / "[ab].csv") == ["a", "b"]
    assert names(clips / "a.csv", clips / "[ab].csv", clips, clips / ".." / "clips") == ["a", "b", "c"]
    of_folder, notes = find_clips([clips], QUICK)
    assert [clip.settings.keypoints[0] for clip in of_folder] == [clips / f"{name}.csv" for name in "abc"]
    assert [says(note, clips, "no known format", "notes.csv, video.mp4") for note in notes] == [True]
    (clips / "truth.csv").write_text("bodyparts;a;a;a\ncoords;x;y;z\n0;1;2;3\n")
    assert says(find_clips([clips], QUICK)[1][0], clips, "3D positions: truth.csv")
    assert {clip.settings.fps for clip in of_folder} == {30}


def test_an_unreadable_file_is_reported(clips, monkeypatch):
    readable = os.access
    monkeypatch.setattr("os.access", lambda path, mode: Path(path).name != "b.csv" and readable(path, mode))
    _, notes = find_clips([clips], QUICK)
    assert [says(note, clips, "not readable: b.csv") for note in notes] == [True]
    with monkeypatch.context() as disk:

        def fails(path: Path, kind: str) -> None:
            raise OSError(5, "Input/output error")

        disk.setattr("recon.api.batch_inputs.recognised", fails)
        with refusal((clips, "files", "no keypoint files")):
            find_clips([clips], QUICK)
    if Path("/proc/self/mem").exists():  # the file exists but cannot be read
        (clips / "mem.csv").symlink_to("/proc/self/mem")
        assert names(clips / "*.csv") == ["a", "b", "c", "mem"]


def test_summary_cells_are_not_formulas(tmp_path):
    summary = Summary([], tmp_path)
    names = ["=1+1", "@a", "'b", "'=c", "plain"]
    summary.rows = {name: dict.fromkeys(COLUMNS) | {"clip": name, "status": name, "frames": -1} for name in names}
    summary.write()
    with summary.path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["clip"] for row in rows] == ["'=1+1", "'@a", "'b", "''=c", "plain"]
    assert {row["frames"] for row in rows} == {"-1"}
    assert [row["clip"] for row in read_rows(summary.path)] == names


def test_a_table_in_two_formats_is_one_clip(clips):
    (clips / "b.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(600))  # damaged, which the fit of the clip reports
    of_folder, notes = find_clips([clips], QUICK)
    assert [clip.settings.keypoints[0].name for clip in of_folder] == ["a.csv", "b.h5", "c.csv"]
    assert [says(note, clips, "same name: b.csv") for note in notes] == [True]


def test_subfolders_are_read_with_recursive(clips):
    (clips / "day2" / "late").mkdir(parents=True)
    shutil.copy(clips / "a.csv", clips / "day2" / "late" / "d.csv")
    of_folder, notes = find_clips([clips], QUICK)
    assert [clip.name for clip in of_folder] == ["a", "b", "c"]
    assert [says(note, clips, "day2", "--recursive") for note in notes] == [True]
    everything, notes = find_clips([clips], QUICK, recursive=True)
    assert [clip.name for clip in everything] == ["a", "b", "c", "d"]
    assert notes == []
    (clips / "day2" / "late" / "motion.npz").touch()
    (note,) = find_clips([clips], QUICK, recursive=True)[1]
    assert says(note, "results of a fit", clips / "day2" / "late")
    (clips / "day2" / "late" / "motion.npz").unlink()
    shutil.copy(CAMERA, clips / "day2" / "late" / "own.toml")
    (day2,), (note,) = find_clips([clips / "day2"], QUICK, recursive=True)
    assert day2.name == "d"
    assert says(note, "camera files", "manifest", "own.toml")


def test_clip_names_are_unique_and_made_from_the_paths(tmp_path):
    for name in ("x/day1/run.csv", "y/day1/run.csv", "z/day2/run.csv", "z/day2/RUN.h5", "z/walk.csv", "walk.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("data")
    files = sorted(tmp_path.rglob("*.*"))
    expected = {
        "x/day1/run.csv": "x-day1-run",
        "y/day1/run.csv": "y-day1-run",
        "z/day2/run.csv": "run-csv",
        "z/day2/RUN.h5": "RUN-h5",
        "z/walk.csv": "z-walk",
        "walk.csv": f"{tmp_path.name}-walk",
    }
    assert dict(zip([f.relative_to(tmp_path).as_posix() for f in files], names(*files), strict=True)) == expected
    backwards = files[::-1]
    assert [expected[f.relative_to(tmp_path).as_posix()] for f in backwards] == names(*backwards)


def test_manifest_rows_override_the_common_options(clips):
    shutil.copy(CAMERA, clips / "mine.toml")
    path = manifest(
        clips,
        "\ufeffkeypoints,out,fps,camera,hfov_deg,image_size_px,method,fast,frames\n"
        "a.csv,first,60,,,,trajectory,true,\n"
        "b.csv,,,mine.toml,,,,,2:6\n"
        "\n"
        f"{SAMPLES / 'whole.csv'},,,,64,1920x1080,,,\n",
    )
    first, second, third = found(path)
    assert (first.name, second.name, third.name) == ("first", "b-2-6", "whole")
    assert first.settings == FitSettings(
        keypoints=(clips / "a.csv",), camera=CAMERA, fps=60, method="trajectory", fast=True, frames="0:4"
    )
    assert second.settings == FitSettings(
        keypoints=(clips / "b.csv",), camera=clips / "mine.toml", fps=30, method="frame", frames="2:6"
    )
    assert third.settings == FitSettings(
        keypoints=(SAMPLES / "whole.csv",),
        hfov_deg=64,
        image_size_px=(1920, 1080),
        fps=30,
        method="frame",
        frames="0:4",
    )


def test_carriage_returns_end_lines_of_manifest_and_keypoints(clips):
    """A manifest and a keypoint file with the line ends of old Macs are read."""
    table = (clips / "a.csv").read_bytes().replace(b"\r\n", b"\n")
    (clips / "a.csv").write_bytes(table.replace(b"\n", b"\r"))
    (clips / "list.csv").write_bytes(b"keypoints;frames\ra.csv;0:4\r\rb.csv;\r")
    first, second, third = found(clips / "list.csv", clips / "a.csv")
    assert (first.settings.keypoints, first.settings.frames) == ((clips / "a.csv",), "0:4")
    assert second.settings.keypoints == (clips / "b.csv",)
    assert third.settings.keypoints == (clips / "a.csv",)
    (clips / "long.csv").write_text("keypoints,out\na.csv,first\nb.csv," + "x" * 200_000)
    refuses([clips / "long.csv"], ("long.csv", "line 3", 131072))


def test_a_manifest_of_a_spreadsheet(clips):
    """Capitals in a header do not matter, and an encoding other than UTF-8 is named."""
    (clips / "list.csv").write_text("Keypoints;Frames;Group\na.csv;0:4;x\n")
    (clip,) = found(clips / "list.csv")
    assert (clip.settings.keypoints, clip.settings.frames) == ((clips / "a.csv",), "0:4")
    for encoding in ("utf-16", "cp1252"):
        (clips / "list.csv").write_text("Keypoints\tFrames\näffchen.csv\t0:4\n", encoding=encoding)
        refuses([clips / "list.csv"], (clips / "list.csv", "text", "not UTF-8", "in Excel"))


def test_common_options_override_the_config(clips, tmp_path):
    config = tmp_path / "settings.toml"
    config.write_text(f'[recon.fit]\nfps = 25\nsigma_px = 5.0\ncamera = "{CAMERA.as_posix()}"\nmethod = "frame"\n')
    (clip,), _ = find_clips([clips / "a.csv"], {"fps": 50.0, "camera": None}, config)
    assert (clip.settings.fps, clip.settings.sigma_px, clip.settings.camera) == (50, 5, (CAMERA,))


def test_common_options_do_not_apply_to_rows_of_the_other_method(clips):
    path = manifest(clips, "keypoints,method,form\na.csv,,\nb.csv,frame,printed\n")
    common = {"camera": CAMERA, "fps": 30, "fast": True}
    first, second = (clip.settings for clip in find_clips([path], common)[0])
    assert (first.method, first.fast) == ("trajectory", True)
    assert (second.method, second.fast, second.form) == ("frame", False, "printed")


def test_clips_of_one_file_have_different_names(clips):
    path = manifest(
        clips, "keypoints;individual;out\na.csv;wolf;\na.csv;dog;\na.csv;dog;\nb.csv;;a-dog-2\nb.csv;;\nc.csv;a/b:c;\n"
    )
    assert names(path) == ["a-wolf", "a-dog", "a-dog-3", "a-dog-2", "b", "c-a_b-c"]


def test_each_animal_of_a_file_is_a_clip(tmp_path):
    """Each animal with points in a file is a clip, unless one is chosen, in every format."""
    header = "scorer" + ",net" * 9 + "\nindividuals" + "".join(f",{name}" * 3 for name in ("one", "two", "never"))
    header += "\nbodyparts" + ",nose" * 9 + "\ncoords" + ",x,y,likelihood" * 3
    (tmp_path / "pair.csv").write_text(f"{header}\n0,1,2,0.9,3,4,0.8,,,\n")
    one, two = found(tmp_path / "pair.csv")
    assert [(clip.name, clip.settings.individual) for clip in (one, two)] == [("pair-one", "one"), ("pair-two", "two")]
    assert one.settings == FitSettings(**{**two.settings.plain(), "individual": "one"})
    assert [clip.name for clip in found(tmp_path / "pair.csv", individual="two")] == ["pair"]
    rows = manifest(tmp_path, "keypoints,out,individual\npair.csv,run,\npair.csv,other,two\n")
    assert names(rows) == ["run-one", "run-two", "other"]


def test_all_problems_with_a_manifest_are_reported(clips):
    path = manifest(
        clips,
        "keypoints,fps,method,out,frames\na.csv,-3,frame,x,\nb.csv,30,walk,X,9:2\n,30,,,\nc.csv,,,../up,\n",
    )
    refuses([path], (path, "line 4, keypoints", "nothing"), common={})
    path.write_text(path.read_text().replace(",30,,,\n", ""))
    refuses(
        [path],
        (path, "line 2, fps", "'-3'", "greater than 0"),
        ("--set likelihood-min", "likelihood_min", 2, "0 to 1"),
        (path, "line 3, frames", "'9:2'", "A < B"),
        (path, "line 3, method", "'walk'", "trajectory or frame"),
        (path, "line 2, out", "'x' more than once"),
        (path, "line 3, out", "'X' more than once"),
        (path, "line 4, out", "'../up'", ["--out", "summary.csv and summary.html"]),
        common={"camera": "camera.toml", "likelihood_min": 2},
    )


def test_inputs_with_too_long_names_are_refused(clips):
    name = "a" * 300
    path = manifest(clips, f"keypoints\n{name}*.csv\n")
    none = (path, "line 2, keypoints", f"{name}*.csv")
    refuses([path, name, f"{name}*"], none, (name, "file"), (f"{name}*", "files", "no files that match"))


def test_problems_with_several_inputs_are_reported_together(clips, tmp_path):
    path = manifest(clips, "keypoints,speed,fps\na.csv,1,2,3,4\n")
    empty = manifest(clips, "keypoints\n", "empty_manifest.csv")
    (tmp_path / "none").mkdir()
    refuses(
        [tmp_path / "typo.csv", tmp_path / "*.h5", tmp_path / "none", path, empty],
        (tmp_path / "typo.csv", "file", "no such file"),
        (tmp_path / "*.h5", "files", "no files that match"),
        (tmp_path / "none", "files", "no keypoint files"),
        (path, "column 'speed'", "unknown", "keypoints, camera"),
        (path, "line 2", "5 cells", 3),
        (empty, "rows", "no rows"),
    )


def test_a_camera_in_a_manifest_replaces_the_common_field_of_view(clips):
    path = manifest(clips, "keypoints,camera\na.csv,\nb.csv,mine.toml\n")
    shutil.copy(CAMERA, clips / "mine.toml")
    wide = {"hfov_deg": 118.0, "lens": "fisheye", "image_size_px": (1920, 1080), "fps": 30}
    first, second = (clip.settings for clip in find_clips([path], wide)[0])
    assert (first.camera, first.lens) == (None, "fisheye")
    assert (second.camera, second.lens) == ((clips / "mine.toml",), None)


def test_a_setting_that_every_clip_lacks_is_reported_once(clips):
    refuses([clips], ("--camera", "camera", "nothing", ["--hfov-deg", "columns keypoints, camera and fps"]), common={})


# Several cameras of one clip

SCENE = SAMPLES / "whole_scene.json"
TWO = {"camera": SCENE, "fps": 120, "fast": True, "frames": "0:8"}


def filmed(folder: Path, *names: str) -> None:
    """Write keypoint files of the sample, of the second camera if the name contains 2 or B, else of the first."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        camera = "cam2" if {"2", "B"} & {*name} else "cam1"
        shutil.copy(SAMPLES / f"whole_{camera}.csv", folder / name)


def cameras(inputs: list[Path], common: dict[str, Any] = TWO, by: str = "auto") -> dict[str, tuple[str, ...] | None]:
    """Return the names of the cameras of each clip."""
    return {clip.name: clip.settings.camera_name for clip in find_clips(inputs, common, cameras_by=by)[0]}


def test_files_are_joined_by_the_names_of_cameras(tmp_path):
    filmed(tmp_path / "day", "walk-cam1.csv", "walk-cam2.csv", "cam2_trot.csv", "cam1.csv", "cam2.csv")
    clips, notes = find_clips([tmp_path / "day"], TWO)
    assert {clip.name: [path.name for path in clip.settings.keypoints] for clip in clips} == {
        "day": ["cam1.csv", "cam2.csv"],
        "trot": ["cam2_trot.csv"],
        "walk": ["walk-cam1.csv", "walk-cam2.csv"],
    }
    assert [clip.settings.camera_name for clip in clips] == [("cam1", "cam2"), ("cam2",), ("cam1", "cam2")]
    assert input_problems(clips) == [(), (), ()]
    several, without = notes
    assert says(several, "4 files", "2 clips", "names", "--cameras-by none")
    assert says(without, "fewer cameras", "trot (cam1)")


@pytest.mark.parametrize("given", [["pose/cam?_json/*.json"], ["pose/cam1_json", "pose/cam2_json"]])
def test_files_of_single_frames_are_one_clip(tmp_path, given):
    """Files of single frames are one clip for each camera folder of Pose2Sim, and several clips can share a folder."""
    for name in ("pose/cam1_json/cam1", "pose/cam2_json/cam2", "both/run", "both/walk"):
        for frame in (3, 4):
            path = tmp_path / f"{name}_{frame:06d}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text('{"people": [{"pose_keypoints_2d": %s}]}' % ([1.0] * 75), encoding="utf-8")
    (clip,), _ = find_clips([tmp_path / one for one in given], TWO)
    assert (clip.name, clip.settings.camera_name) == ("pose", ("cam1", "cam2"))
    assert [path.name for path in clip.settings.keypoints] == ["cam1_000003.json", "cam2_000003.json"]
    assert [*cameras([tmp_path / "both"])] == ["run", "walk"]


@pytest.mark.parametrize(
    ("common", "by"),
    [(TWO, "none"), (TWO | {"camera_name": "cam2"}, "auto"), (QUICK | {"camera": SCENE}, "auto"), (QUICK, "auto")],
)
def test_each_file_is_a_clip_without_joining(tmp_path, common, by):
    """Each file is a clip if `--cameras-by none` is given, one camera is chosen, or the frame method is used."""
    filmed(tmp_path, "walk-cam1.csv", "walk-cam2.csv")
    assert [*cameras([tmp_path], common, by)] == ["walk-cam1", "walk-cam2"]


def test_one_file_for_each_clip_needs_no_joining(tmp_path):
    filmed(tmp_path, "walk-cam1.csv", "trot-cam2.csv")
    assert cameras([tmp_path]) == {"trot-cam2": None, "walk-cam1": None}


def test_a_pattern_finds_cameras_and_clips(tmp_path):
    filmed(tmp_path, "s1 v1.csv", "s1 v2.csv", "s1 v2 late.csv")
    (tmp_path / "other.csv").write_text((tmp_path / "s1 v1.csv").read_text())
    clips, notes = find_clips([tmp_path], TWO, cameras_by=r" v([12])$")
    assert [(clip.name, clip.settings.camera_name) for clip in clips] == [("s1", ("1", "2"))]
    left_out, several = notes
    assert says(left_out, "Left out", "other.csv, s1 v2 late.csv")
    assert says(several, "2 files", "1 clip", "by --cameras-by")
    assert input_problems(clips) == [()]
    named = {"s1": ("v1", "v2"), "s1 late": ("v2",)}
    # The pattern matches the whole name of s1 v1 and s1 v2.
    assert cameras([tmp_path / "s1 v*.csv"], by="v[12]") == named


def test_problems_with_camera_names_in_file_names(tmp_path):
    filmed(tmp_path, "a-cam1.csv", "a_cam1.csv", "b-cam2.csv")

    (twice, _), _ = find_clips([tmp_path], TWO)
    compare(input_problems([twice])[0], [(SCENE, "camera", ["cam1", "two keypoint files"])])
    pattern = ("--cameras-by", "pattern")
    refuses([tmp_path], (*pattern, "a-cam1.csv, a_cam1.csv, b-cam2.csv"), common=TWO, by="view(.)")
    refuses([tmp_path], (*pattern, ["'('", "position 0"], "regular expression"), common=TWO, by="(")
    beside = ("--camera-name", "camera_name", "cam2 together with --cameras-by")
    refuses([tmp_path], beside, common=TWO | {"camera_name": "cam2"}, by="cam.$")
    filmed(tmp_path, "cam1-cam2.csv")
    refuses([tmp_path], ("cam1-cam2.csv", "name", "cam1 and cam2", "--cameras-by none"), common=TWO)


def anipose(project: Path, calibration: Path, square: float, *files: str) -> None:
    """Write an Anipose project with the sample's cameras as A and B."""
    document = {}
    for name, camera in zip("AB", read_cameras(SCENE), strict=True):
        assert camera.rotation is not None
        assert camera.translation_m is not None
        document[f"cam_{name}"] = {
            "name": name,
            "size": list(camera.image_size_px),
            "matrix": camera.matrix.tolist(),
            "distortions": camera.distortion.tolist(),
            "rotation": camera.rotation.tolist(),
            "translation": (camera.translation_m / 0.001).tolist(),
            "fisheye": camera.model == "fisheye",
        }
    (project / calibration).mkdir(parents=True)
    (project / calibration / "calibration.toml").write_text(tomli_w.dumps(document | {"metadata": {"error": 0.4}}))
    config = {
        "nesting": 2,
        "calibration": {"board_square_side_length": square},
        "triangulation": {"cam_regex": "-cam([A-Z])"},
    }
    (project / "config.toml").write_text(tomli_w.dumps(config))
    for file in files:
        filmed(project / Path(file).parent, Path(file).name)


@pytest.mark.parametrize("pattern", ["(a+)+$", "(a|a)+$", "(?:a?){40}b", "a*a*a*a*b", "a" * 300])
def test_a_pattern_with_unbounded_search_time_is_refused(tmp_path, pattern):
    anipose(tmp_path, Path("rex/calibration"), 25.0, f"rex/day1/pose-2d/{'a' * 44}!.csv")
    (tmp_path / "config.toml").write_text(tomli_w.dumps({"nesting": 2, "triangulation": {"cam_regex": pattern}}))
    with refusal((tmp_path / "config.toml", "cam_regex", "may never end", "--cameras-by")):
        find_clips([tmp_path], {"fps": 120, "camera_unit": "mm"})


def test_anipose_projects_are_found(tmp_path):
    """Projects of Anipose are found two folders deep, with a calibration per day and with filtered poses."""
    walk = ("rex/day1/pose-2d/walk-camA.csv", "rex/day1/pose-2d/walk-camB.csv")
    trot = (
        "rex/day2/pose-2d/trot-camA.csv",
        "rex/day2/pose-2d-filtered/trot-camB.csv",
        "rex/day2/pose-2d/walk-camA.csv",
    )
    anipose(tmp_path, Path("rex/calibration"), 25.0, *walk, *trot)
    common = {"fps": 120, "fast": True, "camera_unit": "mm"}
    clips, notes = find_clips([tmp_path], common)
    assert [(clip.name, clip.settings.camera_name) for clip in clips] == [("walk", ("A", "B")), ("trot", ("B",))]
    assert {clip.settings.camera for clip in clips} == {(tmp_path / "rex/calibration/calibration.toml",)}
    assert input_problems(clips) == [(), ()]
    sessions, unfiltered, several, without = notes
    assert says(sessions, "2 Anipose sessions", "3 files", "pose-2d and pose-2d-filtered")
    assert says(unfiltered, "Not read", tmp_path / "rex/day2/pose-2d", "trot-camA, walk-camA")
    assert says(several, "2 files", "1 clip", "cam_regex", tmp_path / "config.toml", "--cameras-by none")
    assert says(without, "fewer cameras", "trot (A)")
    both = [tmp_path / "rex/day1", tmp_path / "rex/day2/pose-2d"]
    assert cameras(both, common) == {"day1-walk": ("A", "B"), "trot": ("A",), "day2-walk": ("A",)}
    assert cameras(both[:1], common, "none") == {"walk-camA": ("A",), "walk-camB": ("B",)}
    (clip,), _ = find_clips(both[:1], common | {"camera": SCENE})
    assert clip.settings.camera == (SCENE,)
    (tmp_path / "config.toml").unlink()  # without it, the calibration names the cameras
    assert cameras(both[:1], common) == {"walk": ("A", "B")}


def test_missing_parts_of_anipose_projects_are_reported(tmp_path):
    anipose(tmp_path, Path("calibration"), 25.0, "pose-2d/walk-camA.csv", "pose-2d/walk-camB.csv")
    config = tmp_path / "config.toml"
    in_mm = (config, "board_square_side_length", [25, "not in metres"], "--camera-unit mm")
    refuses([tmp_path], in_mm, common={"fps": 30})
    whole = config.read_text()
    config.write_text(f"{whole}\n[cameras.A]\noffset = [0, 0]\n[cameras.B]\noffset = [320, 180]\n")
    refuses([tmp_path], (config, "cameras.B.offset", "[320, 180]"), common={"fps": 30, "camera_unit": "mm"})
    config.write_text(whole)
    shutil.rmtree(tmp_path / "calibration")
    none = (tmp_path, "calibration", "none", ["calibration/calibration.toml", "--camera"])
    refuses([tmp_path], none, common={"fps": 30})


def test_a_manifest_row_can_list_several_cameras(tmp_path):
    filmed(tmp_path, "walk-cam1.csv", "walk-cam2.csv", "x1.csv", "y2.csv")
    scene = shutil.copy(SCENE, tmp_path / "scene.json")
    path = manifest(
        tmp_path,
        "keypoints,camera_name,offset_s,out\nwalk-cam*.csv,,,\ny2.csv|x1.csv,cam2 | cam1,0|0.25,other\nx1.csv,1,,\n",
    )
    first, second, third = (clip for clip in find_clips([path], TWO | {"camera": scene})[0])
    assert [first.name, second.name, third.name] == ["walk-cam1", "other", "x1"]
    assert first.settings.keypoints == (tmp_path / "walk-cam1.csv", tmp_path / "walk-cam2.csv")
    assert first.settings.camera_name is None  # the fit finds them in the files' names
    assert second.settings.keypoints == (tmp_path / "y2.csv", tmp_path / "x1.csv")
    assert (second.settings.camera_name, second.settings.offset_s) == (("cam2", "cam1"), (0.0, 0.25))
    assert third.settings.camera_name == ("1",)
    manifest(tmp_path, "keypoints\nz*.csv\n")
    refuses([path], (path, "line 2, keypoints", "z*.csv"))
    manifest(tmp_path, "keypoint,camera\nx1.csv,scene.json\n")  # is read as a manifest with a wrong column name
    refuses([path], (path, "column 'keypoint'", "unknown", "perhaps keypoints"), (path, "line 2, keypoints", "nothing"))
    manifest(tmp_path, "frame,bodypart,x,y,camera\n0,nose,1,2,north\n")
    assert not is_manifest(path)  # a table of keypoints with a column of cameras


def test_a_clip_with_another_set_of_cameras_is_fitted_again(tmp_path):
    """A clip with one camera more or fewer is the same clip, but an unrelated file is another clip."""
    out = tmp_path / "out"
    filmed(tmp_path / "clips", "walk-cam1.csv", "walk-cam2.csv")
    both, _ = find_clips([tmp_path / "clips"], TWO)
    (planned,) = plan_batch(both, out)
    planned.out.mkdir(parents=True)
    with output_of(planned.clip.settings, planned.out, overwrite=True).staged() as folder:
        (folder / "pose3d.csv").write_text("results")
    record = Record(out / RECORD)
    begun = {"made_from": planned.identity, "keypoints": planned.clip.settings.keypoints_from(out)}
    record.note("walk", **begun)
    assert plan_batch(both, out)[0].reason == "not finished before"
    record.note("walk", **begun, files={"pose3d.csv": "of other results"}, row={})
    assert plan_batch(both, out)[0].reason == "not complete"
    assert Summary([planned], out).rows["walk"]["cameras"] == 2
    for camera in ("cam1", "cam2"):
        (clip,), _ = find_clips([tmp_path / "clips" / f"walk-{camera}.csv"], TWO, cameras_by="cam[12]")
        (planned,) = plan_batch([clip], out)
        assert {*planned.reason.removeprefix("changed: ").split(", ")} == {"keypoints", "camera_name"}
    shutil.move(tmp_path / "clips", tmp_path / "moved")
    (clip,), _ = find_clips([tmp_path / "moved" / "walk-cam2.csv"], TWO, cameras_by="cam[12]")
    assert plan_batch([clip], out)[0].action == "refit"
    (tmp_path / "moved" / "walk-cam2.csv").write_text("of another run")
    cam1, cam2 = (tmp_path / "clips" / f"walk-cam{number}.csv" for number in (1, 2))
    with refusal((out / "walk", "folder", f"results of {cam1}, {cam2}", "without results")):
        plan_batch([clip], out)


def test_dry_run_lists_the_cameras_of_each_clip(tmp_path):
    filmed(tmp_path, "walk-cam1.csv", "walk-cam2.csv")
    command = ("batch", tmp_path, "--camera", SCENE, "--fps", 120, "--out", tmp_path / "out", "--dry-run")
    (row,) = json.loads(run(*command, "--json").out)["clips"]
    assert (row["clip"], row["cameras"], row["action"]) == ("walk", ["cam1", "cam2"], "new")
    assert "cam1, cam2" in run(*command).out
    assert "If they differ" not in run(*command).out
    assert [row["clip"] for row in json.loads(run(*command, "--json", "--cameras-by", "none").out)["clips"]] == [
        "walk-cam1",
        "walk-cam2",
    ]
