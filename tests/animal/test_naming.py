"""Test keypoint names: name maps, suggestions for similar names, and the names in the files of detectors."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import refusal, refused, run, says

from recon import ClipAnalysis, FitSettings, InputError, Keypoints, evaluate, load_skeleton, read_pose3d
from recon.animal.body import other_side, side_of
from recon.animal.naming import (
    NameMap,
    builtin_maps,
    fitting_maps,
    load_names,
    map_to_write,
    new_names,
    problem_of_names,
    renamed,
    skeleton_of,
    suggestions,
)
from recon.api.clip_inputs import prepare
from recon.api.clip_results import identity, run_clip
from recon.api.skeleton_check import check_skeleton
from recon.api.skeleton_draft import draft_skeleton
from recon.cli.convert import ConvertSettings, read_any
from recon.fit.motion import Motion
from recon.io.deeplabcut import write_csv
from recon.io.formats import read_keypoints
from recon.keypoint_net.labels import evaluate_2d_files
from recon.robotics.quadruped import load_robot
from recon.robotics.retarget import reference_of, retarget
from recon.show.report import build_report
from recon.testing import detectors
from recon.testing.detectors import ACINOSET, ANIMAL3D, AP_10K, HORSE_10, MMPOSE_AP_10K, SUPERANIMAL, UNSEEN_FRAME

pytestmark = pytest.mark.usefixtures("no_playback")

SAMPLES = Path(__file__).parents[2] / "data" / "samples"


def keypoints(*names: str) -> Keypoints:
    """Return three frames of keypoints: keypoint k is at (10 k, 20 k) px in frame 0 and moves by 1 px per frame."""
    xy = np.arange(len(names))[:, None] * [10.0, 20.0] + np.arange(3.0)[:, None, None]
    return Keypoints(names, xy, np.full((3, len(names)), 0.9), np.arange(3), fps=30.0, source="clip.csv")


def in_file(folder: Path, text: str) -> Path:
    path = folder / "names.csv"
    path.write_text(text, encoding="utf-8")
    return path


RACEHORSE = ("nose", "poll", "withers", "croup", "LF_carpi", "LF_hoof_tip", "RF_hoof_tip", "LH_hock", "LH_hoof_tip")
RACEHORSE += ("RH_hoof_tip", "RH_fetlock")
"""Names of a real project, with croup for the rear."""

# Maps


WOLF = detectors.split_names(
    "snout,left_eye,right_eye,neck,withers,sacrum,tail_base,tail_mid,tail_tip,left_shoulder,left_elbow,left_wrist",
    "left_forepaw,right_shoulder,right_elbow,right_wrist,right_forepaw,left_hip,left_stifle,left_hock,left_hindpaw",
    "right_hip,right_stifle,right_hock,right_hindpaw",
)


@pytest.mark.parametrize(
    "text",
    [
        "file,skeleton\nleft_eye,l_eye\nthroat,\n",
        "# mine\nleft_eye,l_eye\n\nthroat,\n",
        "left_eye;l_eye\nthroat;\n",
        "\ufeffleft_eye\tl_eye\r\nthroat\t\r\n",
        '"left_eye", l_eye\n throat ,""',
    ],
)
def test_a_map_has_two_columns(text, tmp_path):
    assert load_names(in_file(tmp_path, text)).names == {"left_eye": "l_eye", "throat": ""}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("left_eye\n", [("line 1", "'left_eye'")]),
        ("a,b,c\n,d\ne,f\ne,g", [("line 1", "'a,b,c'"), ("line 2", "',d'"), ("line 4", "'e' a second time")]),
        ("a,\x1b[2J", [("line 1", r"'a,\x1b[2J'")]),
        ("file,skeleton\n", [("lines", "no names")]),
        ("a" * 200_000 + ",b\n", [("line 1", "'" + "a" * 59)]),
    ],
)
def test_faults_of_a_map_are_listed(text, expected, tmp_path):
    path = in_file(tmp_path, text)
    with refusal(*((path, *one) for one in expected)):
        load_names(path)


def test_an_unknown_map_name_is_refused():
    with refusal(("--rename", "name or file", "'superanimal'", "one of anatomical, animal3d")):
        load_names("superanimal")


def test_points_follow_their_names():
    """Points follow their names, even if two names are exchanged, and a note states what was renamed."""
    file = keypoints("a", "b", "c", "d")
    new = renamed(file, NameMap("map.csv", {"a": "b", "b": "a", "c": "", "x": "y"}))
    assert new.names == ("b", "a", "d")
    np.testing.assert_array_equal(new.xy_px, file.xy_px[:, [0, 1, 3]])
    assert new.confidence.shape == (3, 3)
    (note,) = new.notes
    assert says(note, "3 of 4 keypoints", "map.csv", "left out: c", "in the file: x")


def test_a_map_that_does_not_fit_is_refused():
    for names, *expected in (
        ({"x": "y"}, ["x: none", "clip.csv"], "a, b"),
        ({"a": "b"}, "'b' for a, b", "only one"),
        ({"a": "", "b": ""}, ["every keypoint", "clip.csv"]),
    ):
        with refusal(("map.csv", "names", *expected)):
            renamed(keypoints("a", "b"), NameMap("map.csv", names))


@pytest.mark.parametrize(
    ("bundled", "names", "of_cheetah"),
    [
        ("superanimal-quadruped", SUPERANIMAL, 19),
        ("ap-10k", AP_10K, 17),
        ("ap-10k", MMPOSE_AP_10K, 17),
        ("animal3d", ANIMAL3D, 19),
        ("anatomical", WOLF, 23),
    ],
)
def test_bundled_maps(bundled, names, of_cheetah):
    """Built-in maps contain only names of their detector and keep the sides, and a fit finds its own map."""
    by = load_names(bundled)
    cheetah = load_skeleton("cheetah-24")
    if names not in (MMPOSE_AP_10K, WOLF):  # these maps match words, not whole names
        assert {*by.names} <= {*names}
    _, new, note = new_names(names, by, "clip.csv")
    assert len({*new} & {*cheetah.markers}) == of_cheetah
    assert {*cheetah.feet} <= {*new}
    for old, its in by.names.items():
        side = {"l": "left", "r": "right"}.get(its[0]) if its[1] == "_" else None
        assert (side is None) == (cheetah.side_of(old) is None)
        assert side in (None, cheetah.side_of(old))
    assert "not in the file" not in note
    assert fitting_maps(names, cheetah.markers)[0] == bundled


def test_a_bundled_map_accepts_any_spelling_of_a_name(tmp_path):
    by = load_names("anatomical")
    for carpus in ("left_carpus", "Left_Carpus", "LeftCarpus", "leftCarpus", "L_carpus", "carpus_L", "Carpus left"):
        _, new, _ = new_names(["nose", carpus, carpus.replace("arpus", "arpals")], by, "clip.csv")
        assert new == ("nose", "l_front_ankle", carpus.replace("arpus", "arpals"))
    assert by.get("LeftCarpus") == by.get("left_carpus") != by.get("RightCarpus")
    own = load_names(in_file(tmp_path, "left_carpus,paw"))
    assert (own.get("LeftCarpus"), own.get("left_carpus")) == (None, "paw")


@pytest.mark.parametrize(
    ("name", "marker"),
    [
        ("LF_carpi", "l_front_ankle"),
        ("RH_Hip", "r_hip"),
        ("FR_elbow", "r_front_knee"),
        ("hock_RH", "r_back_ankle"),
        ("L_B_Stiffle", "l_back_knee"),
        ("lh_hoof_tip", "l_back_paw"),
        ("HLPaw", "l_back_paw"),
        ("thoracic_left_wrist", "l_front_ankle"),
        ("LFcarpus", "l_front_ankle"),
        ("RHhock", "r_back_ankle"),
        ("right_pelvic_limb_paw", "r_back_paw"),
        ("TailSet", "tail_base"),
        ("L_B_Elbow", None),  # a hind leg has no elbow
    ],
)
def test_names_with_leg_codes_are_recognised(name, marker):
    assert load_names("anatomical").get(name) == marker
    expected = None if marker is None or marker[1] != "_" else {"l": "left", "r": "right"}[marker[0]]
    assert side_of(name) == (expected if marker else "left")
    assert side_of(other_side(name)) == (side_of(name) and {"left": "right", "right": "left"}[side_of(name)])


def test_every_bundled_map_is_tested():
    """Maps without tests here have them in tests/fit/test_bodies.py and tests/animal/test_body.py."""
    assert builtin_maps() == (
        "anatomical",
        "animal3d",
        "ap-10k",
        "coco-17",
        "mouse-15",
        "rat-23",
        "superanimal-quadruped",
    )


@pytest.mark.parametrize(
    ("names", "skeleton", "unused"), [(ACINOSET, "cheetah-24", {"lure"}), (HORSE_10, "horse-22", set())]
)
def test_names_of_a_detector_select_a_skeleton(names, skeleton, unused):
    markers = load_skeleton(skeleton).markers
    assert {*names} - {*markers} == unused
    assert {*markers} <= {*names}


# Near misses


def test_similar_names_are_suggested():
    near = suggestions(
        ["left_eye", "Nose", "front_right_paw", "rear_left_foot", "rootOfTail", "withers", "chin", "Left.Shoulder"],
        ["l_eye", "r_eye", "nose", "r_front_paw", "l_back_paw", "l_front_paw", "tail_base", "spine", "l_shoulder"],
    )
    assert near == {
        "left_eye": "l_eye",
        "Nose": "nose",
        "front_right_paw": "r_front_paw",
        "rear_left_foot": "l_back_paw",
        "rootOfTail": "tail_base",
        "Left.Shoulder": "l_shoulder",
    }
    assert suggestions(["r_sholder", "shoulder"], ["l_shoulder", "r_shoulder"]) == {"r_sholder": "r_shoulder"}


def test_lines_of_a_map_to_write(tmp_path):
    lines = list(map_to_write(["nose", "left_eye", "chin"], ["nose", "l_eye", "spine"]))
    assert lines == ["file,skeleton", "left_eye,l_eye", "chin,"]
    assert [*map_to_write(["LF_carpi", "poll"], ["l_front_ankle", "nose"])][1:] == ["LF_carpi,l_front_ankle", "poll,"]
    assert load_names(in_file(tmp_path, "\n".join(lines))).names == {"left_eye": "l_eye", "chin": ""}
    # A map that knows only some of the names completes those that are similar to markers.
    lines = [*map_to_write(["Nose", "Tail_1", "Tail_tip"], load_skeleton("mouse-top").markers)]
    assert lines[1:] == ["Nose,nose", "Tail_1,tail1", "Tail_tip,tail_end"]
    markers = load_skeleton("quadruped").markers
    lines = [*map_to_write(["back_middle", "front_left_thai", "front_left_paw", "antler"], markers)]
    assert lines[1:] == ["back_middle,spine", "front_left_thai,l_shoulder", "front_left_paw,l_front_paw", "antler,"]


def test_the_summary_names_what_is_used_and_near_misses(small_trajectory):
    """The summary lists the used keypoints and similar names: r_eye is missing in the clip, and the ear is not used."""
    source = small_trajectory.sources[0]
    file = replace(source, file_names=tuple("right_eye" if name == "ear" else name for name in source.file_names))
    for motion, said in (
        (small_trajectory, "23 of the skeleton's 24 used; missing: r_eye; not used: ear"),
        (
            replace(small_trajectory, sources=(file,)),
            "23 of the skeleton's 24 used; missing: r_eye; not used: right_eye; perhaps only named differently: "
            'fit again with --rename and a file of these lines: "right_eye,r_eye"',
        ),
    ):
        assert dict(build_report(motion)["lines"])["keypoints"] == said


# Choosing a skeleton from keypoint names


@pytest.mark.parametrize(
    ("names", "placed"),
    [(SUPERANIMAL, 22), (AP_10K, 17), (MMPOSE_AP_10K, 17), (ANIMAL3D, 21), (ACINOSET, 24), (RACEHORSE, 9)],
)
def test_a_skeleton_is_drafted_from_names(names, placed, tmp_path):
    """A skeleton drafted from names can be used and has the pose of the quadruped.

    A keypoint may have the name of one of its segments, such as neck.
    """
    markers, others, text = draft_skeleton(names, "mine", Path("clip.csv"))
    assert len(markers) == placed
    assert {*markers} | {*others} == {*names}
    file = tmp_path / "mine.toml"
    file.write_text(text, encoding="utf-8")
    body, quadruped = load_skeleton(file), load_skeleton("quadruped")
    assert {*body.markers} == {*markers}
    at, of = (dict(zip(b.markers, b.expected_points_m(), strict=True)) for b in (body, quadruped))
    for name, marker in markers.items():
        np.testing.assert_allclose(at[name], of[marker], atol=1e-12)
    assert {label: markers[foot] for label, foot in body.feet_by_label().items()} == quadruped.feet_by_label()
    assert check_skeleton(file)["remarks"] == []
    assert {*body.limb_sides().values()} == {"left", "right", None}


def test_a_draft_needs_both_ends_of_the_trunk():
    names = ["nose", "l_eye", "r_eye", "neck_base", "withers"]
    with refusal(("clip.csv", "bodyparts", ", ".join(names), ["rear", "(tail_base, l_hip, spine)", "--camera"])):
        draft_skeleton(names, "mine", Path("clip.csv"))


def test_recon_skeleton_from_keypoints(tmp_path):
    clip, out = as_named_by("superanimal-quadruped", tmp_path / "clip.csv", SUPERANIMAL), tmp_path / "mine.toml"
    ended = run("skeleton", "from-keypoints", clip, "--out", out)
    assert (ended.code, ended.err) == (0, "")
    assert says(ended.out, f"{out}: 22 of 39 keypoints")
    assert "back_base as withers" in ended.out
    assert "Not on the skeleton: upper_jaw, lower_jaw, " in ended.out
    assert load_skeleton(out).name == "mine"
    refused(["skeleton", "from-keypoints", clip, "--out", out], ("--out", "file", out, "--overwrite"))
    assert prepare(settings(clip, skeleton=out)).body.name == "mine"


# Commands


def as_named_by(bundled: str, path: Path, names: tuple[str, ...]) -> Path:
    """Write the sample of a cheetah with only the keypoints of a detector, under their names, and return the path."""
    file, of = read_keypoints(SAMPLES / "whole.csv"), load_names(bundled).names
    T, K = len(file.frames), len(names)
    xy, confidence = np.full((T, K, 2), np.nan), np.zeros((T, K))
    for k, name in enumerate(names):
        if (new := of.get(name, name)) in file.names:
            xy[:, k] = file.xy_px[:, file.names.index(new)]
            confidence[:, k] = file.confidence[:, file.names.index(new)]
    write_csv(replace(file, names=tuple(names), xy_px=xy, confidence=confidence), path)
    return path


def settings(clip: Path, **more) -> FitSettings:
    return FitSettings(keypoints=(clip,), camera=SAMPLES / "camera.toml", fps=60.0, **more)


def test_a_fit_accepts_the_names_of_a_detector(tmp_path):
    clip = as_named_by("superanimal-quadruped", tmp_path / "clip.csv", SUPERANIMAL)
    (source,) = prepare(settings(clip, rename="superanimal-quadruped")).sources
    native = prepare(settings(SAMPLES / "whole.csv")).sources[0].keypoints
    assert source.keypoints.names == native.names
    lacking = [n for n in native.names if n not in source.file_names]
    assert lacking == ["tail1", "l_front_ankle", "r_front_ankle", "l_back_ankle", "r_back_ankle"]
    known = [native.names.index(n) for n in native.names if n not in lacking]
    np.testing.assert_allclose(source.keypoints.xy_px[:, known], native.xy_px[:, known], atol=1e-3)
    assert any(says(note, "19 of 39 keypoints", "superanimal-quadruped") for note in source.cleaning.notes)


@pytest.mark.parametrize("name", detectors.FILES)
def test_a_detectors_own_file(name, tmp_path):
    """A detector's own file is read without any option, and gives the same points as the skeleton's own names.

    The file has the detector's layout, with several animals and a frame that the detector did not see.
    """
    bundled, write = detectors.FILES[name]
    write(tmp_path / name, read_keypoints(SAMPLES / "whole.csv"))
    (source,) = prepare(settings(tmp_path / name, rename=bundled)).sources
    native = prepare(settings(SAMPLES / "whole.csv")).sources[0].keypoints
    found = source.keypoints
    assert (found.names, found.frames.tolist()) == (native.names, native.frames.tolist())
    known = [j for j, marker in enumerate(native.names) if marker in source.file_names]
    assert len(known) == {"superanimal-quadruped": 19, "animal3d": 19, "ap-10k": 17, None: 24}[bundled]
    rows = native.frames != UNSEEN_FRAME
    np.testing.assert_allclose(found.xy_px[rows][:, known], native.xy_px[rows][:, known], atol=1e-3)
    assert not found.present[UNSEEN_FRAME].any()
    assert not found.present[:, [j for j in range(len(native.names)) if j not in known]].any()


def test_every_bundled_map_has_a_file_of_its_detector():
    of_four_legs = {*builtin_maps()} - {"coco-17", "mouse-15", "rat-23", "anatomical"}
    assert of_four_legs == {bundled for bundled, _ in detectors.FILES.values() if bundled}


@pytest.mark.slow
def test_from_superanimals_file_to_a_robot(whole_results, tmp_path):
    """A file of SuperAnimal is fitted and its motion transferred to a robot.

    It has all 39 keypoints in DeepLabCut's spelling. The result has four feet with their sides, the gait, and nearly
    the accuracy of the skeleton's own names.
    """
    detectors.write_superanimal(tmp_path / "clip.csv", read_keypoints(SAMPLES / "whole.csv"))
    run_clip(settings(tmp_path / "clip.csv", rename="superanimal-quadruped"), tmp_path / "clip")
    found, native = Motion.load(tmp_path / "clip"), Motion.load(whole_results)
    assert found.foot_names == {"LF": "l_front_paw", "RF": "r_front_paw", "LH": "l_back_paw", "RH": "r_back_paw"}
    assert all(side == limb.partition(" ")[0] for limb, side in found.limb_sides.items() if "leg" in limb)
    assert ClipAnalysis(found).gait.name.name == ClipAnalysis(native).gait.name.name == "transverse gallop"
    assert retarget(reference_of(found), load_robot("a1")).clip.margin_rad.min() >= 0
    truth = read_pose3d(SAMPLES / "whole_truth.csv")
    renamed_m, native_m = (evaluate(results.upright, truth).mpjpe_m.mean for results in (found, native))
    assert renamed_m < 1.3 * native_m


def test_few_names_are_refused_with_the_map_to_write(tmp_path):
    """A file with few known names is refused, and the message contains a map that `--rename` accepts."""
    clip = as_named_by("superanimal-quadruped", tmp_path / "clip.csv", SUPERANIMAL)
    args = ["fit", clip, "--camera", SAMPLES / "camera.toml", "--fps", 60, "--out", tmp_path / "out"]
    expected = ["cheetah-24", "--rename superanimal-quadruped", "--rename with a file"]
    (problem,) = refused(args, (clip, "bodyparts", "nose, neck_base, tail_base", expected))
    assert problem.details[:2] == ("file,skeleton", "upper_jaw,")
    written = in_file(tmp_path, "\n".join(problem.details))
    (source,) = prepare(settings(clip, rename=written)).sources
    assert {"l_eye", "r_front_paw", "l_back_knee"} <= {*source.file_names}


@pytest.mark.parametrize(
    ("skeleton", "remedy", "other"),
    [("quadruped", "--rename superanimal-quadruped", "cheetah-24"), ("human-25", "--skeleton", "")],
)
def test_the_given_skeleton_is_kept_if_a_map_fits_it_as_well(skeleton, remedy, other):
    names = [*load_names("superanimal-quadruped").names, "antler_base_left"]
    names = [name for name in names if name not in ("left_earbase", "right_earbase", "back_base")]
    problem = problem_of_names(names, load_skeleton(skeleton).markers, skeleton, "clip.csv")
    assert says(problem.expected, remedy)
    assert not other or other not in problem.expected


def test_a_built_in_map_with_all_names_is_suggested_alone():
    names = [*load_names("rat-23").names]
    wanted = load_skeleton("rat").markers
    problem = problem_of_names(names, wanted, "rat", "clip.csv")
    assert problem.expected.endswith("--rename rat-23")
    assert not problem.details
    assert problem_of_names([*names, "TailTip"], wanted, "rat", "clip.csv").details


def test_renaming_works_in_files_of_several_animals(tmp_path):
    """`--rename` works in files of several animals, in which every name occurs once for each animal."""
    rows = list(csv.reader((SAMPLES / "whole.csv").read_text().splitlines()))
    rows = [[*row, *row[1:]] for row in rows]
    half = (len(rows[0]) - 1) // 2
    rows.insert(1, ["individuals", *["one"] * half, *["two"] * half])
    clip = tmp_path / "two.csv"
    with clip.open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    names = in_file(tmp_path, "spine,mid_back\nl_eye,\n")
    out = tmp_path / "renamed.csv"
    ended = run("convert", clip, out, "--individual", "two", "--rename", names)
    assert (ended.code, ended.err) == (0, "")
    assert says(ended.out, "2 of 24 keypoints", "names.csv", "left out: l_eye")
    new, old = read_keypoints(out), read_keypoints(SAMPLES / "whole.csv")
    assert new.names == tuple("mid_back" if n == "spine" else n for n in old.names if n != "l_eye")
    np.testing.assert_array_equal(new.xy_px[:, new.names.index("mid_back")], old.xy_px[:, old.names.index("spine")])


def test_positions_in_3d_are_not_renamed(tmp_path):
    with refusal(("--rename", "names", ["3D positions", SAMPLES / "whole_truth.csv"], "2D keypoints")):
        read_any(SAMPLES / "whole_truth.csv", ConvertSettings(rename=str(in_file(tmp_path, "spine,mid_back"))))


def test_labels_and_predictions_of_other_names(tmp_path):
    from recon.keypoint_net.labels import read_labels

    names = in_file(tmp_path, "".join(f"{n},{n.upper()}\n" for n in ("nose", "l_eye", "spine")))
    labels = read_labels(SAMPLES / "rendered.mp4", SAMPLES / "rendered_labels.csv", rename=str(names))
    before = read_labels(SAMPLES / "rendered.mp4", SAMPLES / "rendered_labels.csv")
    assert labels.names[:2] == ("NOSE", "L_EYE")
    np.testing.assert_array_equal(labels.xy_px, before.xy_px)
    named = tmp_path / "labels.csv"
    label_file = read_keypoints(SAMPLES / "rendered_labels.csv")
    write_csv(replace(label_file, names=tuple(f"label {n}" for n in label_file.names)), named)
    with pytest.raises(InputError) as error:
        evaluate_2d_files(SAMPLES / "rendered_points.csv", named)
    assert error.value.problems[0].details[0] == "file,skeleton"
    by = in_file(tmp_path, "nose,label nose\nspine,label spine\n")
    found = evaluate_2d_files(SAMPLES / "rendered_points.csv", named, rename=str(by))
    same = evaluate_2d_files(SAMPLES / "rendered_points.csv", SAMPLES / "rendered_labels.csv")
    assert found["per_keypoint"] == {f"label {n}": same["per_keypoint"][n] for n in ("nose", "spine")}


def test_a_batch_identifies_a_map_by_its_content(tmp_path):
    names = in_file(tmp_path, "left_eye,l_eye\n")
    one = identity(settings(SAMPLES / "whole.csv", rename=names))
    assert {*one["inputs"]} == {"keypoints", "camera", "rename"}
    assert "rename" not in one["settings"]
    in_file(tmp_path, "left_eye,r_eye\n")
    assert identity(settings(SAMPLES / "whole.csv", rename=names)) != one
    bundled = identity(settings(SAMPLES / "whole.csv", rename="ap-10k"))
    assert bundled["settings"]["rename"] == "ap-10k"
    assert json.dumps(bundled)


@pytest.mark.parametrize("name", ["horse-22", "dog-27", "quadruped", "cheetah-24", "human-25", "mouse-top", "rat"])
def test_the_skeleton_of_keypoints_is_found(name):
    markers = load_skeleton(name).markers
    assert skeleton_of([*markers, "another"]) == name
    assert skeleton_of(markers[1:]) is None
