"""Many clips: which they are, what is done again and what is not, and what faults do to the others."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from command_line import Refusal, compare, refusal, refused, run, run_tasks_here, says

from recon import FitSettings, InputError, find_clips, fit_clip, plan_batch, run_batch
from recon.api.analyse import AnalyseSettings
from recon.api.batch import COLUMNS, RECORD, Summary, fit_planned, input_problems, read_rows
from recon.api.batch_inputs import Clip, is_manifest
from recon.api.clip_results import Record, output_of, run_clip
from recon.base import parallel
from recon.base.locks import sole_writer
from recon.base.outputs import Output
from recon.base.parallel import Event, outcome_of
from recon.base.progress import silent
from recon.cli.analyse import analyse_command
from recon.io.calibration import read_cameras

SAMPLES = Path(__file__).parents[2] / "data" / "samples"
CAMERA = SAMPLES / "camera.toml"
QUICK = {"camera": CAMERA, "fps": 30, "method": "frame", "frames": "0:4"}
pytestmark = pytest.mark.usefixtures("no_playback", "undrawn", "frames_solved_once")
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at processes in /proc")


@pytest.fixture
def clips(tmp_path) -> Path:
    """A folder with three clips of the frame method."""
    folder = tmp_path / "clips"
    folder.mkdir()
    for name in ("a", "b", "c"):
        shutil.copy(SAMPLES / "noisy.csv", folder / f"{name}.csv")
    return folder


def found(*inputs: object, **common: Any) -> list[Clip]:
    return find_clips([str(one) for one in inputs], QUICK | common)[0]


def names(*inputs: object) -> list[str]:
    return [clip.name for clip in found(*inputs)]


def manifest(folder: Path, text: str, name: str = "manifest.csv") -> Path:
    (folder / name).write_text(text)
    return folder / name


def refuses(inputs: list[object], *expected: Refusal, common: dict[str, Any] = QUICK, by: str = "auto") -> None:
    with refusal(*expected):
        find_clips([str(one) for one in inputs], common, cameras_by=by)


def table(out: Path) -> dict[str, dict[str, str]]:
    """summary.csv by clip, which stands in it once."""
    with (out / "summary.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    by_clip = {row["clip"]: row for row in rows}
    assert len(by_clip) == len(rows)
    assert tuple(rows[0]) == COLUMNS
    return by_clip


def staging_folders(out: Path) -> list[Path]:
    return list(out.rglob(".recon-partial-*"))


# ---- inputs ----


def test_files_patterns_and_folders(clips):
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


def test_a_file_that_may_not_be_read_is_said(clips, monkeypatch):
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
    if Path("/proc/self/mem").exists():  # nothing of it can be read
        (clips / "mem.csv").symlink_to("/proc/self/mem")
        assert names(clips / "*.csv") == ["a", "b", "c", "mem"]


def test_no_cell_of_the_summary_is_a_formula(tmp_path):
    summary = Summary([], tmp_path)
    names = ["=1+1", "@a", "'b", "'=c", "plain"]
    summary.rows = {name: dict.fromkeys(COLUMNS) | {"clip": name, "status": name, "frames": -1} for name in names}
    summary.write()
    with summary.path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["clip"] for row in rows] == ["'=1+1", "'@a", "'b", "''=c", "plain"]
    assert {row["frames"] for row in rows} == {"-1"}
    assert [row["clip"] for row in read_rows(summary.path)] == names


def test_a_folder_has_one_clip_for_a_table_in_two_formats(clips):
    (clips / "b.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(600))  # damaged: the clip will say so
    of_folder, notes = find_clips([clips], QUICK)
    assert [clip.settings.keypoints[0].name for clip in of_folder] == ["a.csv", "b.h5", "c.csv"]
    assert [says(note, clips, "same name: b.csv") for note in notes] == [True]


def test_folders_within_a_folder(clips):
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


def test_names_are_unique_and_follow_from_the_paths(tmp_path):
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


def test_manifest_rows_overrule_the_common_options(clips):
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


def test_lines_that_end_as_on_old_macs(clips):
    """Neither a manifest nor a keypoint file of that kind ends the batch."""
    table = (clips / "a.csv").read_bytes().replace(b"\r\n", b"\n")
    (clips / "a.csv").write_bytes(table.replace(b"\n", b"\r"))
    (clips / "list.csv").write_bytes(b"keypoints;frames\ra.csv;0:4\r\rb.csv;\r")
    first, second, third = found(clips / "list.csv", clips / "a.csv")
    assert (first.settings.keypoints, first.settings.frames) == ((clips / "a.csv",), "0:4")
    assert second.settings.keypoints == (clips / "b.csv",)
    assert third.settings.keypoints == (clips / "a.csv",)
    (clips / "long.csv").write_text("keypoints,out\na.csv,first\nb.csv," + "x" * 200_000)
    refuses([clips / "long.csv"], ("long.csv", "line 3", 131072))


def test_common_options_lie_over_config(clips, tmp_path):
    config = tmp_path / "settings.toml"
    config.write_text(f'[recon.fit]\nfps = 25\nsigma_px = 5.0\ncamera = "{CAMERA.as_posix()}"\nmethod = "frame"\n')
    (clip,), _ = find_clips([clips / "a.csv"], {"fps": 50.0, "camera": None}, config)
    assert (clip.settings.fps, clip.settings.sigma_px, clip.settings.camera) == (50, 5, (CAMERA,))


def test_common_options_of_one_method_are_not_for_rows_of_the_other(clips):
    path = manifest(clips, "keypoints,method,form\na.csv,,\nb.csv,frame,printed\n")
    common = {"camera": CAMERA, "fps": 30, "fast": True}
    first, second = (clip.settings for clip in find_clips([path], common)[0])
    assert (first.method, first.fast) == ("trajectory", True)
    assert (second.method, second.fast, second.form) == ("frame", False, "printed")


def test_clips_of_one_file_are_told_apart(clips):
    path = manifest(
        clips, "keypoints;individual;out\na.csv;wolf;\na.csv;dog;\na.csv;dog;\nb.csv;;a-dog-2\nb.csv;;\nc.csv;a/b:c;\n"
    )
    assert names(path) == ["a-wolf", "a-dog", "a-dog-3", "a-dog-2", "b", "c-a_b-c"]


def test_each_animal_of_a_file_is_a_clip(tmp_path):
    """Each animal with points is one, unless one is chosen, and as it is read by whatever reads it."""
    header = "scorer" + ",net" * 9 + "\nindividuals" + "".join(f",{name}" * 3 for name in ("one", "two", "never"))
    header += "\nbodyparts" + ",nose" * 9 + "\ncoords" + ",x,y,likelihood" * 3
    (tmp_path / "pair.csv").write_text(f"{header}\n0,1,2,0.9,3,4,0.8,,,\n")
    one, two = found(tmp_path / "pair.csv")
    assert [(clip.name, clip.settings.individual) for clip in (one, two)] == [("pair-one", "one"), ("pair-two", "two")]
    assert one.settings == FitSettings(**{**two.settings.plain(), "individual": "one"})
    assert [clip.name for clip in found(tmp_path / "pair.csv", individual="two")] == ["pair"]
    rows = manifest(tmp_path, "keypoints,out,individual\npair.csv,run,\npair.csv,other,two\n")
    assert names(rows) == ["run-one", "run-two", "other"]


def test_all_problems_of_a_manifest_at_once(clips):
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


def test_names_that_are_too_long_are_no_files(clips):
    name = "a" * 300
    path = manifest(clips, f"keypoints\n{name}*.csv\n")
    none = (path, "line 2, keypoints", f"{name}*.csv")
    refuses([path, name, f"{name}*"], none, (name, "file"), (f"{name}*", "files", "none that match"))


def test_problems_of_several_inputs_at_once(clips, tmp_path):
    path = manifest(clips, "keypoints,speed,fps\na.csv,1,2,3,4\n")
    empty = manifest(clips, "keypoints\n", "empty_manifest.csv")
    (tmp_path / "none").mkdir()
    refuses(
        [tmp_path / "typo.csv", tmp_path / "*.h5", tmp_path / "none", path, empty],
        (tmp_path / "typo.csv", "file", "no such file"),
        (tmp_path / "*.h5", "files", "none that match"),
        (tmp_path / "none", "files", "no keypoint files"),
        (path, "column 'speed'", "unknown", "keypoints, camera"),
        (path, "line 2", "5 cells", 3),
        (empty, "rows", "none"),
    )


def test_what_every_clip_lacks_is_said_once(clips):
    refuses([clips], ("--camera", "camera", "nothing", ["--hfov-deg", "columns keypoints, camera and fps"]), common={})


# ---- several cameras of one clip ----

SCENE = SAMPLES / "whole_scene.json"
TWO = {"camera": SCENE, "fps": 120, "fast": True, "frames": "0:8"}


def filmed(folder: Path, *names: str) -> None:
    """Keypoint files of the sample that two cameras filmed: of the second where 2 or B is in the name."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        camera = "cam2" if {"2", "B"} & {*name} else "cam1"
        shutil.copy(SAMPLES / f"whole_{camera}.csv", folder / name)


def cameras(inputs: list[Path], common: dict[str, Any] = TWO, by: str = "auto") -> dict[str, tuple[str, ...] | None]:
    """The cameras of each clip, by name."""
    return {clip.name: clip.settings.camera_name for clip in find_clips(inputs, common, cameras_by=by)[0]}


def test_files_of_one_clip_are_known_by_the_names_of_cameras(tmp_path):
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
    """In Pose2Sim's folders, one for each camera; files of several clips in a folder are as many."""
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
def test_files_are_clips_by_themselves_where_that_is_meant(tmp_path, common, by):
    """Also with the frame method, and without other cameras."""
    filmed(tmp_path, "walk-cam1.csv", "walk-cam2.csv")
    assert [*cameras([tmp_path], common, by)] == ["walk-cam1", "walk-cam2"]


def test_one_file_of_each_clip_is_as_it_always_was(tmp_path):
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
    assert cameras([tmp_path / "s1 v*.csv"], by="v[12]") == named  # all that it fits is the name


def test_what_is_wrong_with_cameras_in_names(tmp_path):
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
    """An Anipose project with the sample's cameras as A and B."""
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
def test_a_pattern_of_a_file_that_can_take_for_ever_is_refused(tmp_path, pattern):
    anipose(tmp_path, Path("rex/calibration"), 25.0, f"rex/day1/pose-2d/{'a' * 44}!.csv")
    (tmp_path / "config.toml").write_text(tomli_w.dumps({"nesting": 2, "triangulation": {"cam_regex": pattern}}))
    with refusal((tmp_path / "config.toml", "cam_regex", "may never end", "--cameras-by")):
        find_clips([tmp_path], {"fps": 120, "camera_unit": "mm"})


def test_projects_of_anipose(tmp_path):
    """Sessions two folders deep, a calibration for a day, one of them with filtered poses."""
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
    sessions, several, without = notes
    assert says(sessions, "2 Anipose sessions", "3 files", "pose-2d and pose-2d-filtered")
    assert says(several, "2 files", "1 clip", "cam_regex", tmp_path / "config.toml", "--cameras-by none")
    assert says(without, "fewer cameras", "trot (A)")
    both = [tmp_path / "rex/day1", tmp_path / "rex/day2/pose-2d"]
    assert cameras(both, common) == {"day1-walk": ("A", "B"), "trot": ("A",), "day2-walk": ("A",)}
    assert cameras(both[:1], common, "none") == {"walk-camA": ("A",), "walk-camB": ("B",)}
    (clip,), _ = find_clips(both[:1], common | {"camera": SCENE})
    assert clip.settings.camera == (SCENE,)
    (tmp_path / "config.toml").unlink()  # then the cameras' names are those of the calibration
    assert cameras(both[:1], common) == {"walk": ("A", "B")}


def test_what_projects_of_anipose_lack(tmp_path):
    anipose(tmp_path, Path("calibration"), 25.0, "pose-2d/walk-camA.csv", "pose-2d/walk-camB.csv")
    config = tmp_path / "config.toml"
    in_mm = (config, "board_square_side_length", [25, "not in metres"], "--camera-unit mm")
    refuses([tmp_path], in_mm, common={"fps": 30})
    shutil.rmtree(tmp_path / "calibration")
    none = (tmp_path, "calibration", "none", ["calibration/calibration.toml", "--camera"])
    refuses([tmp_path], none, common={"fps": 30})


def test_a_row_of_a_manifest_with_several_cameras(tmp_path):
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
    manifest(tmp_path, "keypoint,camera\nx1.csv,scene.json\n")  # not a keypoint file of an unknown format
    refuses([path], (path, "column 'keypoint'", "unknown"), (path, "line 2, keypoints", "nothing"))
    manifest(tmp_path, "frame,bodypart,x,y,camera\n0,nose,1,2,north\n")
    assert not is_manifest(path)  # keypoints, of which a column says by which camera


def test_a_camera_more_or_less_is_the_same_clip_again(tmp_path):
    """But a file that has nothing to do with it is another."""
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


def test_a_look_says_which_cameras_a_clip_has(tmp_path):
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


# ---- what is done, and what is done again ----


def fit(clips: list[Clip], out: Path, overwrite: bool = False) -> list[tuple[str, str]]:
    """(action, reason) of each clip, and do it, in this process."""
    plan = plan_batch(clips, out, overwrite)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("recon.api.batch.run_tasks", run_tasks_here)
        summary = run_batch(plan, out)
    assert {*summary.counts()} <= {"done", "done earlier"}
    return [(planned.action, planned.reason) for planned in plan]


def test_finished_clips_are_known_by_their_content(clips, tmp_path):
    out, one = tmp_path / "out", clips / "a.csv"
    camera = shutil.copy(CAMERA, tmp_path / "camera.toml")
    assert fit(found(one, camera=camera), out) == [("new", "")]
    first = {path.name: path.read_bytes() for path in (out / "a").iterdir()}
    assert json.loads(first["report.json"])["summary"]["frames"] == 4

    os.utime(one, (1, 1))
    assert fit(found(one, camera=camera), out) == [("done", "")]
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    shutil.move(one, moved / "a.csv")
    shutil.move(camera, moved / "other.toml")
    camera = moved / "other.toml"
    assert fit(found(moved / "a.csv", camera=camera), out) == [("done", "")]
    shutil.move(moved / "a.csv", one)
    # the trajectory method's settings have no effect on the frame method
    config = tmp_path / "config.toml"
    config.write_text("[recon.fit]\nfast = true\n")
    assert plan_batch(find_clips([one], QUICK | {"camera": camera}, config)[0], out)[0].action == "done"
    assert {path.name: path.read_bytes() for path in (out / "a").iterdir()} == first

    def planned(overwrite: bool = False, **common: Any) -> tuple[str, str]:
        (clip,) = plan_batch(found(one, camera=camera, **common), out, overwrite)
        return clip.action, clip.reason

    for file, what in ((one, "keypoints"), (camera, "camera")):
        content = file.read_text()
        file.write_text(content + "# changed\n" * (file == camera) + "\n")
        assert planned() == ("refit", f"changed: {what}")
        file.write_text(content)
    assert planned(overwrite=True) == ("refit", "--overwrite")
    assert planned() == ("done", "")
    assert planned(fps=60, likelihood_min=0.6) == ("refit", "changed: fps, likelihood_min")
    one.write_text(one.read_text() + "\n")
    (out / "a" / "angles.csv").unlink()
    assert fit(found(one, camera=camera, fps=60), out) == [("refit", "changed: keypoints, fps")]
    (out / "a" / "angles.csv").unlink()
    assert fit(found(one, camera=camera, fps=60), out) == [("refit", "not complete")]
    assert planned(fps=60) == ("done", "")


def test_corrections_in_a_clip_s_folder_are_fitted(clips, tmp_path):
    out, clip = tmp_path / "out", found(clips / "a.csv")
    (out / "a").mkdir(parents=True)
    (out / "a" / "corrections.csv").write_text("frame,keypoint,now_x_px,now_y_px\n3,nose,,\n")
    (planned,) = plan_batch(clip, out)
    assert planned.clip.settings.corrections == out / "a" / "corrections.csv"
    assert "corrections" in planned.identity["inputs"]


def test_another_version_does_not_count(clips, tmp_path):
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    record = out / RECORD
    record.write_text(record.read_text().replace('"version": "', '"version": "0.0.'))
    assert plan_batch(found(clips / "a.csv"), out)[0].reason == "changed: version of recon"


def test_a_fit_that_was_killed_is_not_finished(clips, tmp_path):
    """Between the results' arrival and the end of the record."""
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    started, finished = (out / RECORD).read_text().splitlines()
    for left in (started, f"{started}\n{finished[:-20]}"):  # the second after a full disk
        (out / RECORD).write_text(left)
        assert plan_batch(found(clips / "a.csv"), out)[0].reason == "not finished before"
    assert fit(found(clips / "a.csv"), out) == [("refit", "not finished before")]
    assert fit(found(clips / "a.csv"), out) == [("done", "")]


def test_results_of_others_are_left_alone(clips, tmp_path):
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    run_clip(FitSettings(keypoints=clips / "b.csv", **QUICK), out / "b")  # by hand
    run_clip(FitSettings(keypoints=clips / "a.csv", **QUICK), out / "a", overwrite=True)  # over a batch's
    other = tmp_path / "other"
    other.mkdir()
    (other / "c.csv").write_text((clips / "c.csv").read_text())
    fit(found(other / "c.csv"), out)
    (clips / "c.csv").write_text((clips / "c.csv").read_text() + "\n")
    unknown = ("folder", "no batch has written", "--overwrite")
    with refusal((out / "a", *unknown), (out / "b", *unknown), (out / "c", "folder", f"results of {other / 'c.csv'}")):
        plan_batch(found(clips), out)
    assert [p.reason for p in plan_batch(found(clips), out, overwrite=True)] == ["--overwrite"] * 3


def test_what_comes_after_the_fit_does_not_have_it_made_again(clips, tmp_path):
    """But results that are missing do; those that somebody changed are not touched."""
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    analyse_command(AnalyseSettings(folder=out / "a", figures=False))
    (out / "a" / "notes.txt").write_text("of the user")
    (planned,) = plan_batch(found(clips / "a.csv"), out)
    assert planned.action == "done"
    table = (out / "a" / "pose3d.csv").read_bytes()
    (out / "a" / "pose3d.csv").write_bytes(table.replace(b"1", b"2", 1))  # of the same size
    for overwrite in (False, True):
        with refusal((out / "a" / "pose3d.csv", "file", "did not write, or that was changed since", "moved away")):
            plan_batch(found(clips / "a.csv"), out, overwrite)
    (out / "a" / "pose3d.csv").unlink()
    assert fit(found(clips / "a.csv"), out) == [("refit", "not complete")]
    assert (out / "a" / "pose3d.csv").read_bytes() == table


def test_what_another_process_is_writing_to_is_left_alone(clips, tmp_path, monkeypatch):
    monkeypatch.setattr("recon.api.batch.DYING_S", 0.0)
    out = tmp_path / "out"
    (planned,) = plan_batch(found(clips / "a.csv"), out)
    with sole_writer(out):
        with refusal((out, "folder", ["another process", os.getpid()], "wait")):
            run_batch([planned], out, jobs=1)
        with sole_writer(out / "a"):
            outcome = outcome_of(fit_planned, planned, silent)
    assert outcome["status"] == "failed"
    assert says(outcome["error"], f"{out / 'a'}: folder", "another process", os.getpid())
    assert not out.exists()


def test_a_clip_that_fails_leaves_nothing_but_older_results(clips, tmp_path, in_process):
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    for name in "ab":
        (clips / f"{name}.csv").write_text("scorer,x\n")
    plan = plan_batch(found(clips / "a.csv", clips / "b.csv"), out)
    summary = run_batch(plan, out)
    for planned in plan:
        row = summary.rows[planned.clip.name]
        assert (row["status"], row["attempts"]) == ("failed", 1)
        assert row["error"].startswith(f"{planned.clip.settings.keypoints_text}: header: ")
    assert sorted(path.name for path in out.iterdir() if path.is_dir()) == ["a"]
    assert (out / "a" / "pose3d.csv").is_file()
    assert plan_batch(found(clips / "a.csv"), out)[0].reason == "not finished before"


def test_another_version_on_the_worker(clips, tmp_path):
    (planned,) = plan_batch(found(clips / "a.csv"), tmp_path / "out")
    planned = replace(planned, identity={**planned.identity, "version": "99"})
    outcome = outcome_of(fit_planned, planned, silent)
    assert outcome["status"] == "failed"
    assert says(outcome["error"], 99)
    assert not (tmp_path / "out" / "a").exists()


def test_the_record_has_one_row_a_clip_when_a_batch_begins(clips, tmp_path):
    out = tmp_path / "out"
    fit(found(clips / "a.csv", clips / "b.csv"), out)
    assert len((out / RECORD).read_text().splitlines()) == 4
    before = Record(out / RECORD).rows
    with (out / RECORD).open("a") as file:
        file.write('{"schema": 1, "part": 3}\n{"part": "a", "sch')  # of another version, and cut off
    assert fit(found(clips), out) == [("done", ""), ("done", ""), ("new", "")]
    rows = [json.loads(line) for line in (out / RECORD).read_text().splitlines()]
    assert [(row["part"], "files" in row) for row in rows] == [("a", True), ("b", True), ("c", False), ("c", True)]
    assert Record(out / RECORD).rows.items() > before.items()


def test_a_record_that_somebody_spoilt_is_named_by_line_and_field(clips, tmp_path):
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    row = Record(out / RECORD).rows["a"]
    spoilt: list[tuple[object, str, Any]] = [
        (row | {"identity": {"inputs": [], "version": 2}}, "identity.inputs", "a table"),
        (row | {"files": ["manifest.json"]}, "files", "a table"),
        (row | {"keypoints": 3}, "keypoints", "a list"),
        ([], "content", "a table"),
    ]
    for line, field, expected in spoilt:
        (out / RECORD).write_text(f"{json.dumps(row)}\n{json.dumps(line)}\n")
        with pytest.raises(InputError) as caught:
            plan_batch(found(clips / "a.csv"), out)
        first = caught.value.problems[0]
        assert (first.file, first.field, first.expected) == (f"{out / RECORD}, line 2", field, expected)
    (out / RECORD).write_text(f"nonsense\n{json.dumps(row)}\n")
    with refusal((f"{out / RECORD}, line 1", "content")):
        plan_batch(found(clips / "a.csv"), out)
    (out / RECORD).write_text(json.dumps(row | {"row": {"status": "done", "pose_mm": "wide", "verdict": ["use"]}}))
    where = f"{out / RECORD}, row of a"
    refused(args(clips / "a.csv", out), (where, "pose_mm", "wide", "number"), (where, "verdict", "use", "text"))
    del row["row"]
    (out / RECORD).write_text(json.dumps(row))
    assert plan_batch(found(clips / "a.csv"), out)[0].action == "refit"


def test_a_summary_that_somebody_spoilt_is_named_by_line_and_column(clips, tmp_path):
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    summary = out / "summary.csv"
    kept = summary.read_text()
    summary.write_text(kept.replace(",4,4,", ",6,many,").replace("frames,", "rows,", 1))
    refused(["report", out], (f"{summary}, line 2", "frames_with_pose", "many", "number"))
    summary.write_text(kept.replace("clip,", "name,"))
    refused(["report", out], (f"{summary}, line 2", "clip", "nothing", "text"))


def test_input_problems(clips, tmp_path):
    (clips / "a.csv").write_text("scorer,x\n")
    (clips / "b.csv").unlink()
    path = manifest(clips, "keypoints,camera\na.csv,none.toml\nb.csv,\nc.csv,\n")
    first, second, third = input_problems(found(path))
    assert [Path(p.file).name for p in first] == ["a.csv", "none.toml"]
    assert [p.found for p in second] == ["no such file"]
    assert third == ()


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"tilt_deg": 5}, "tilt_deg"),
        ({"side": "left", "method": "trajectory"}, "side"),
        ({"skeleton": "dog-27"}, "name or file"),
        ({"frames": "900:950"}, "frames"),
        ({"camera": None, "hfov_deg": 60, "image_size_px": "300x200"}, "image size"),
    ],
)
def test_a_look_finds_what_the_fit_refuses(clips, wrong, field):
    (clip,) = found(clips / "a.csv", **wrong)
    with pytest.raises(InputError) as caught:
        fit_clip(clip.settings)
    (seen,) = input_problems([clip])
    assert seen == caught.value.problems
    assert [problem.field for problem in seen] == [field]


def test_what_many_clips_lack_is_said_once(clips, tmp_path):
    """Each with a camera file of its own, as one folder a recording has it."""
    plain = "matrix = [[1600, 0, 960], [0, 1600, 540], [0, 0, 1]]\nsize = [1920, 1080]\ndistortions = [0, 0, 0, 0, 0]\n"
    pose = "rotation = [0, 0, 0]\ntranslation = [0, 0, 0]\n"
    for name in "abc":
        two = "".join(f'[{camera}]\nname = "{camera}"\n{plain}{pose}' for camera in ("cam_a", "cam_b"))
        (clips / f"{name}.toml").write_text(two)
    path = manifest(clips, "keypoints,camera\na.csv,a.toml\nb.csv,b.toml\nc.csv,c.toml\n")
    command = ["batch", path, "--set", "method=frame", "--fps", 30, "--out", tmp_path / "out"]
    three = f"{clips / 'a.toml'} and 2 more files"
    (problem,) = refused(command, (three, "camera", "2 cameras", ["cam_a, cam_b", "--camera-name"]))
    assert not (tmp_path / "out").exists()
    ended = run(*command, "--dry-run")
    assert f"a, b, c: {problem}" in ended.out
    assert ended.out.count("no choice") == 1
    assert says(ended.out, "3 clips", "0 new", "0 to fit", "0 done", "3 that cannot")


# ---- processes ----


def killer(*, once: str = "", always: str = "") -> Any:
    """Kills the worker of a clip at its first, or at every sign of life."""
    killed: set[int] = set()

    def on_event(event: Event, summary: Summary) -> None:
        wanted = event.name == always or (event.name == once and not killed)
        if event.kind == "progress" and wanted and event.pid not in killed:
            assert event.pid is not None
            if event.name == once:
                killed.add(event.pid)
            os.kill(event.pid, signal.SIGKILL)

    return on_event


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is of POSIX")
def test_faults_take_only_their_clip(clips, tmp_path):
    (clips / "broken.csv").write_text("scorer,x\n")
    (clips / "empty.csv").touch()
    shutil.copy(clips / "a.csv", clips / "d.csv")
    out = tmp_path / "out"
    plan = plan_batch(found(clips / "*.csv"), out)
    on_event = killer(once="a")
    also = killer(always="b")

    def both(event: Event, summary: Summary) -> None:
        on_event(event, summary)
        if event.name != "a":
            also(event, summary)

    run_batch(plan, out, jobs=2, retries=1, on_event=both)
    rows = table(out)
    assert {name: (row["status"], row["attempts"]) for name, row in rows.items()} == {
        "a": ("done", "2"),
        "b": ("failed", "2"),
        "broken": ("failed", "1"),
        "c": ("done", "1"),
        "d": ("done", "1"),
        "empty": ("failed", "1"),
    }
    assert says(rows["b"]["error"], "SIGKILL", "memory")
    assert says(rows["empty"]["error"], f"{clips / 'empty.csv'}: file", "empty")
    assert (out / "b" / "crash.log").read_text().startswith(rows["b"]["error"])
    assert staging_folders(out) == []

    report = json.loads((out / "c" / "report.json").read_text())
    row, speeds = rows["c"], report["root_path"]["smoothed"] or report["root_path"]["exact"]
    assert row["keypoints"] == "../clips/c.csv"  # from the summary's folder
    assert row["out"] == "c"
    assert row["frames"] == row["frames_with_pose"] == "4"
    assert float(row["mean_reprojection_px"]) == report["summary"]["reprojection_px"]["mean"]
    assert int(row["outliers"]) == report["summary"]["outliers"]
    assert row["corrected"] == "0"
    assert float(row["peak_speed_m_s"]) == speeds["peak_speed_m_s"]
    assert float(row["mean_speed_m_s"]) == speeds["mean_speed_m_s"]
    assert row["size"] == ""
    assert rows["d"]["inputs_hash"] == rows["c"]["inputs_hash"] != rows["broken"]["inputs_hash"]
    assert len({row["settings_hash"] for row in rows.values()}) == 1

    again = plan_batch(found(clips / "*.csv"), out)
    assert [planned.action for planned in again] == ["done", "new", "new", "done", "done", "new"]


def test_what_failed_is_done_again_beside_what_is_done(clips, tmp_path):
    out = tmp_path / "out"
    fit(found(clips / "a.csv"), out)
    speed = str(Record(out / RECORD).rows["a"]["row"]["peak_speed_m_s"])
    Output(out / "b", "batch").write("crash.log", "the worker was killed")
    Output(out / "a", "batch").write("crash.log", "of a user")
    (out / "a" / "crash.log").write_text("mine")
    assert fit(found(clips / "[ab].csv"), out) == [("done", ""), ("new", "")]
    rows = table(out)
    assert (rows["a"]["status"], rows["a"]["attempts"], rows["b"]["status"]) == ("done earlier", "0", "done")
    assert rows["a"]["peak_speed_m_s"] == speed
    assert not (out / "b" / "crash.log").exists()
    assert (out / "a" / "crash.log").read_text() == "mine"


# ---- the command ----


def args(clips: Path, out: Path, *more: object) -> list[object]:
    given = [f"--{name}={value}" for name, value in QUICK.items() if name != "method"]
    return ["batch", clips, *given, "--set", f"method={QUICK['method']}", "--out", out, *more]


def test_dry_run_looks_only(clips, tmp_path):
    out = tmp_path / "out"
    (clips / "c.csv").write_text("scorer,x\n")
    fit(found(clips / "a.csv", clips / "b.csv"), out)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    ended = run(*args(clips, out, "--dry-run", "--json"))
    rows = json.loads(ended.out)["clips"]
    assert [(row["clip"], row["action"]) for row in rows] == [("a", "done"), ("b", "done"), ("c", "cannot be fitted")]
    assert rows[2]["out"] == str(out / "c")
    assert len(rows[2]["problems"]) == 1
    assert "header" in rows[2]["problems"][0]
    assert (ended.code, run(*args(clips, out, "--dry-run", "--strict")).code) == (0, 1)
    ended = run(*args(clips, out, "--dry-run", "--fps", 60))
    assert says(ended.out, "3 clips", "0 new", "2 to fit", "0 done", "1 that cannot")
    assert "refit (changed: fps)" in ended.out
    assert says(ended.out, "--camera and --fps")
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_command(clips, tmp_path, in_process):
    """A line for each clip, --strict and the summary as JSON."""
    out = tmp_path / "out"
    (clips / "c.csv").write_text("scorer,x\n")
    fit(found(clips / "a.csv", clips / "b.csv"), out)
    ended = run(*args(clips, out))
    assert ended.code == 0
    assert ended.out.startswith("2 of 3 clips are done already.\n")
    rows_of_table = [line.split()[:2] for line in ended.out.split("\n")[1:] if line.startswith("  ") and line.strip()]
    assert rows_of_table[-3:] == [["c", "failed"], ["a", "check"], ["b", "check"]]
    assert "\n2 check, 1 failed in " in ended.out
    assert says(ended.out, f"Open {out / 'summary.html'}", f"recon report {out}/CLIP", f"recon compare {out} --out")
    assert ended.err.startswith(f"[1/1] failed  c: {clips / 'c.csv'}: header: ")
    ended = run(*args(clips, out, "--strict", "--quiet", "--json"))
    assert ended.code == 1
    summary = json.loads(ended.out)
    assert summary["counts"] == {"done earlier": 2, "failed": 1}
    assert [row["clip"] for row in summary["clips"]] == ["a", "b", "c"]
    assert {name: row["status"] for name, row in table(out).items()} == {
        "a": "done earlier",
        "b": "done earlier",
        "c": "failed",
    }


def test_unusable_input_ends_it_before_any_work(clips, tmp_path):
    out = tmp_path / "out"
    command = ["batch", clips, "--fps", 30, "--out", out]
    refused(command, ("--camera", "camera", "nothing"))
    wrong = ["--camera", clips / "none.toml", "--skeleton", "unicorn"]
    refused([*command, *wrong], ("none.toml", "file", "no such file"), ("--skeleton", "name or file", "'unicorn'"))
    (tmp_path / "file").touch()
    refused(args(clips, tmp_path / "file"), ("--out", "folder", tmp_path / "file"))
    assert not out.exists()


def workers(pid: int) -> list[int]:
    """The processes that fit clips: its children but for Python's own helper, which ends with it."""
    lists = Path(f"/proc/{pid}/task").glob("*/children")
    children = [int(child) for path in lists for child in path.read_text().split()]
    return [child for child in children if b"resource_tracker" not in Path(f"/proc/{child}/cmdline").read_bytes()]


def wait_for(condition: Any, seconds: float = 300) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.02)


def statuses(out: Path) -> list[str]:
    return [row["status"] for row in table(out).values()] if (out / "summary.csv").exists() else []


HELD = """
import signal, time
from recon.api.batch import Summary
from recon.api.clip_results import Record
from recon.cli.app import main

# Where the tests run in the background, Ctrl-C is ignored, and children inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)
Summary.write_if_due = Summary.write
note, begun = Record.note, []

def note_and_wait(self, part, made_from, **details):
    note(self, part, made_from, **details)
    if "files" not in details:
        begun.append(part)
    if len(begun) == 2:
        begun.append("")
        time.sleep(300)

Record.note = note_and_wait
main()
"""
"""The command line, where `recon batch` gives out no third clip and waits: it has not ended however slow a test is."""


@pytest.fixture
def in_the_middle(clips, tmp_path) -> Iterator[tuple[subprocess.Popen[str], Path, list[object]]]:
    """`recon batch` on four clips in a process of its own, after the first is done; its folder and its arguments."""
    shutil.copy(clips / "a.csv", clips / "d.csv")
    command = args(clips, tmp_path / "out", "--jobs", 1)
    code = [sys.executable, "-c", HELD, *map(str, command)]
    with subprocess.Popen(code, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            wait_for(lambda: "done" in statuses(tmp_path / "out"))
            yield process, tmp_path / "out", command
        finally:
            process.kill()


def finished(out: Path) -> dict[str, int]:
    """The moment of each finished clip."""
    done = [name for name, row in Record(out / RECORD).rows.items() if "files" in row]
    return {name: (out / name / "report.json").stat().st_mtime_ns for name in done}


def some_left(clips: Path, done: dict[str, int]) -> int:
    """How many clips are to be done: one at most, the others are taken away."""
    left = sorted(path for path in clips.glob("*.csv") if path.stem not in done)
    for path in left[1:]:
        path.unlink()
    return len(left[:1])


@pytest.mark.slow
@linux
def test_ctrl_c_keeps_what_is_done(clips, in_the_middle, in_process):
    process, out, command = in_the_middle
    (worker,) = workers(process.pid)
    process.send_signal(signal.SIGINT)
    said, errors = process.communicate(timeout=300)
    assert process.returncode == 130
    assert not Path(f"/proc/{worker}").exists()
    done = finished(out)
    assert 1 <= len(done) <= 2
    assert sorted(statuses(out)) == ["done"] * len(done) + ["pending"] * (4 - len(done))
    (line,) = errors.splitlines()
    assert says(line, "Stopped", f"{len(done)} done, {4 - len(done)} pending", "same command again")
    assert "Traceback" not in said
    assert staging_folders(out) == []
    assert sorted(path.name for path in out.iterdir() if path.is_dir()) == sorted(done)
    left = some_left(clips, done)
    assert run(*command).code == 0
    assert statuses(out) == ["done earlier"] * len(done) + ["done"] * left
    assert finished(out).items() >= done.items()


@pytest.mark.slow
@linux
def test_after_a_kill_nothing_that_is_finished_is_done_again(clips, in_the_middle, in_process):
    process, out, command = in_the_middle
    (worker,) = workers(process.pid)
    process.kill()
    wait_for(lambda: not Path(f"/proc/{worker}").exists() or "Z" in Path(f"/proc/{worker}/stat").read_text().split())
    done = finished(out)
    assert 1 <= len(done) <= 2
    left = some_left(clips, done)
    assert run(*command).code == 0
    assert statuses(out).count("done earlier") == len(done)
    assert statuses(out).count("done") == left
    assert finished(out).items() >= done.items()
    assert staging_folders(out) == []


# ---- a cluster ----


@pytest.fixture
def cluster() -> Iterator[Any]:
    """Two Dask workers, each a process with one thread."""
    distributed = pytest.importorskip("distributed")
    with (
        warnings.catch_warnings(action="default"),  # Dask's own
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
    ):
        yield cluster


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # Dask's own
def test_dask_cluster(clips, tmp_path, cluster):
    (clips / "broken.csv").write_text("scorer,x\n")
    out = tmp_path / "out"
    plan = plan_batch(found(clips / "*.csv"), out)
    pids = {one.worker_address: one.pid for one in cluster.workers.values()}
    killed: list[int] = []

    def kill_one(event: Event, summary: Summary) -> None:
        if summary.rows[event.name]["status"] == "done" and not killed:
            nanny = next(iter(cluster.workers.values()))
            pid = pids[nanny.worker_address]
            nanny.close_gracefully()  # it starts no other in its place: the one that is left does its clips
            killed.append(pid)
            os.kill(pid, signal.SIGKILL)

    run_batch(plan, out, scheduler=cluster.scheduler_address, on_event=kill_one)
    assert killed
    rows = table(out)
    assert {name: row["status"] for name, row in rows.items()} == {
        **dict.fromkeys("abc", "done"),
        "broken": "failed",
    }
    assert set(finished(out)) == set("abc")
    assert [planned.action for planned in plan_batch(found(clips / "*.csv"), out)].count("done") == 3


@pytest.fixture
def certificates(tmp_path) -> dict[str, str]:
    """Dask's settings of a cluster with encryption: one key for all, with a certificate that it signed itself."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("no openssl")
    key, certificate = str(tmp_path / "key.pem"), str(tmp_path / "certificate.pem")
    made = ("req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost")
    subprocess.run([openssl, *made, "-keyout", key, "-out", certificate], check=True, capture_output=True)
    own = {
        f"distributed.comm.tls.{who}": {"key": key, "cert": certificate} for who in ("scheduler", "worker", "client")
    }
    return {"distributed.comm.tls.ca-file": certificate, "distributed.comm.require-encryption": True} | own


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # Dask's own
def test_a_cluster_with_certificates(clips, tmp_path, certificates):
    """They are those of Dask's own configuration; without them there is a message, and nothing is done."""
    dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")
    one, out = clips / "a.csv", tmp_path / "out"
    with dask.config.set(certificates):
        how = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None, "protocol": "tls://"}
        cluster = distributed.LocalCluster(**how, processes=False, security=distributed.Security())
    with cluster:
        assert cluster.scheduler_address.startswith("tls://")
        at = cluster.scheduler_address
        refused(args(one, out, "--scheduler", at), ("--scheduler", at, "TLS", ["tls://", "distributed.comm.tls"]))
        with dask.config.set(certificates):
            ended = run(*args(one, out, "--scheduler", cluster.scheduler_address))
        assert (ended.code, statuses(out)) == (0, ["done"])


def test_no_cluster(clips, tmp_path):
    pytest.importorskip("distributed")
    nonsense = "nonsense://here"
    refused(args(clips, tmp_path / "out", "--scheduler", nonsense), ("--scheduler", nonsense, "nonsense", "tcp://"))


@pytest.mark.parametrize("scheme", ["tcp", "tls"])
def test_a_scheduler_that_says_nothing_is_not_waited_for(scheme, monkeypatch):
    pytest.importorskip("distributed")

    monkeypatch.setattr(parallel, "CONNECT_S", 0.3)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        began = time.monotonic()
        at = f"{scheme}://127.0.0.1:{silent.getsockname()[1]}"
        found, expected = ("0.3 s", "tcp://") if scheme == "tcp" else ("TLS", "distributed.comm.tls")
        with refusal(("--scheduler", at, found, expected)):
            parallel._client(at)
        assert time.monotonic() - began < 60  # for ever without the limit
