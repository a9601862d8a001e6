"""Make the files that the pages of docs/ name, from the samples."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from recon import Body, Camera, Keypoints, Pose3D, load_skeleton, read_camera, read_pose3d
from recon.calibrate.boards import parse_board
from recon.clip import select_frames
from recon.io import columns
from recon.io.bones import write_bvh
from recon.io.deeplabcut import write_csv
from recon.io.formats import read_keypoints
from recon.io.video import video_writer
from recon.io.writing import write_table
from recon.show.rig import make_rig
from recon.testing.boards import board_poses, draw_board
from recon.testing.detectors import write_mmpose
from tests.fuzz.corpus import write_sleap

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = ROOT / "data" / "samples"
DOCS = ROOT / "docs"
CAT = DOCS / "my-cat.toml"
CAT_FPS = 100.0
FENCE = re.compile(r"^(?P<indent> *)```(?P<language>\S*)\n(?P<text>.*?)^(?P=indent)```$", re.DOTALL | re.MULTILINE)


class Block(NamedTuple):
    page: Path
    line: int
    language: str
    text: str


def blocks(page: Path) -> Iterator[Block]:
    content = page.read_text(encoding="utf-8")
    for match in FENCE.finditer(content):
        indent = match["indent"]
        text = "".join(line.removeprefix(indent) for line in match["text"].splitlines(keepends=True))
        yield Block(page, content.count("\n", 0, match.start()) + 1, match["language"], text)


def commands(block: Block) -> Iterator[str]:
    """Yield the commands of a shell block one by one, without comments."""
    for line in re.sub(r"\\\n\s*", "", block.text).splitlines():
        words = shlex.split(line, comments=True)
        if words:
            yield shlex.join(words) if words[0] == "recon" else line.strip()


def toml_of(page: str) -> list[str]:
    return re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / page).read_text(encoding="utf-8"), re.DOTALL)


def sample(name: str) -> Callable[[Path], None]:
    return lambda path: Path(shutil.copy(SAMPLES / name, path)).touch()


def keypoints() -> Keypoints:
    return replace(read_keypoints(SAMPLES / "whole.csv"), fps=60.0)


def pose() -> Pose3D:
    return replace(read_pose3d(SAMPLES / "whole_truth.csv"), fps=60.0)


def _first(count: int) -> Callable[[Path], None]:
    """Return a function that writes the first `count` frames of the sample to a path."""

    def make(path: Path) -> None:
        lines = (SAMPLES / "whole.csv").read_text().splitlines(keepends=True)
        path.write_text("".join(lines[: 3 + count]))

    return make


def _clips(path: Path) -> None:
    """Write two clips, each with the first 20 frames of the sample."""
    path.mkdir()
    lines = (SAMPLES / "whole.csv").read_text().splitlines(keepends=True)
    for name in ("run1", "run2"):
        (path / f"{name}.csv").write_text("".join(lines[:23]))


def _filmed_twice(folder: Path, name: str) -> None:
    """Write the keypoint files of two cameras with the first 15 frames of the sample run."""
    folder.mkdir(exist_ok=True)
    for camera in ("cam1", "cam2"):
        lines = (SAMPLES / f"whole_{camera}.csv").read_text().splitlines(keepends=True)
        (folder / f"{name}-{camera}.csv").write_text("".join(lines[:18]))


def _in_mm(path: Path) -> None:
    """Write the true joints of the sample in millimetres, like the triangulated points of another program."""
    write_csv(replace(pose(), xyz_m=1000 * pose().xyz_m), path)
    _, *rest = path.read_text(encoding="utf-8").splitlines(keepends=True)
    names = len(rest[0].split(",")) - 1
    path.write_text("".join(["scorer" + ",DLC" * names + "\n", *rest]), encoding="utf-8")


def _sleap(path: Path) -> None:
    write_sleap(keypoints(), path)


def _of_other_names(path: Path) -> None:
    names = {"spine": "mid_back", "l_eye": "left_eye", "r_eye": "left_ear"}
    file = select_frames(keypoints(), (0, 30))
    write_sleap(replace(file, names=tuple(names.get(name, name) for name in file.names)), path)


def _mmpose(path: Path) -> None:
    write_mmpose(path, read_keypoints(SAMPLES / "whole.csv"))


def _two_animals(path: Path) -> None:
    """Write DeepLabCut's file of two animals, with a level of individuals in the header."""
    import pandas as pd

    columns, values = [], []
    for animal in ("animal1", "animal2"):
        table = pd.read_csv(SAMPLES / "whole.csv", header=[0, 1, 2], index_col=0)
        columns += [(scorer, animal, *rest) for scorer, *rest in table.columns]
        values.append(table.to_numpy())
    names = ["scorer", "individuals", "bodyparts", "coords"]
    both = pd.DataFrame(np.concatenate(values, axis=1), columns=pd.MultiIndex.from_tuples(columns, names=names))
    both.to_hdf(path, key="df_with_missing")


def _bvh(path: Path) -> None:
    """Write a BVH file in centimetres."""
    body = load_skeleton("cheetah-24")
    write_bvh(make_rig(body, 100.0, body.markers, np.arange(3), np.zeros((3, body.n_state)), 60.0), path)


def _track(path: Path) -> None:
    """Write the track of a camera on a tripod."""
    camera = read_camera(SAMPLES / "camera.toml")
    assert camera.rotation is not None
    assert camera.translation_m is not None
    q = Rotation.from_matrix(camera.rotation).as_quat()[[3, 0, 1, 2]]
    row = ",".join(map(repr, [*q.tolist(), *camera.translation_m.tolist()]))
    path.write_text("frame,qw,qx,qy,qz,tx,ty,tz\n" + "".join(f"{frame},{row}\n" for frame in range(60)))


def _long(path: Path) -> None:
    columns.write_long(replace(keypoints(), fps=None), path)
    head, _, rest = path.read_text().partition("\n")
    path.write_text(head.replace("frame,bodypart,x,y,likelihood", "Nr,Node,X pos,Y pos,Q") + "\n" + rest)


def _wide(path: Path) -> None:
    clip = keypoints()
    names = ["Nr", *(f"{axis} of {name}" for name in clip.names for axis in "XY")]
    write_table(path, [names], clip.frames, clip.xy_px.reshape(len(clip.frames), -1))


def _runs(path: Path) -> None:
    """Write the sample forwards, backwards and forwards again, in two files.

    A prior of 16 components needs 320 frames.
    """
    there = pose().xyz_m
    write_csv(replace(pose(), xyz_m=np.concatenate([there, there[::-1], there]), frames=np.arange(180)), path)


def _board(description: str, model: str, count: int) -> list[np.ndarray]:
    """Return pictures (640x480) of a board, taken by a camera with a wide or a normal lens."""
    board, rng = parse_board(description), np.random.default_rng(1)
    matrix = np.array([[420.0, 0, 320], [0, 420, 240], [0, 0, 1]])
    distortion = {"radtan": [-0.1, 0.02, 0, 0, 0], "fisheye": [-0.02, 0.003, 0, 0]}[model]
    camera = Camera("made", matrix, np.array(distortion), model, (640, 480))  # pyright: ignore[reportArgumentType]
    return [
        draw_board(board, camera, R, t, oversample=4, blur_px=0.6, noise=2.0, rng=rng)
        for R, t in board_poses(board, camera, count, rng)
    ]


def _pictures(path: Path) -> None:
    path.mkdir()
    for i, picture in enumerate(_board("chessboard:9x6:25mm", "radtan", 14)):
        cv2.imwrite(str(path / f"{i:02}.png"), picture)


def _board_video(path: Path) -> None:
    """Write a video with three frames of each view of a board."""
    with video_writer(path, (640, 480), 25.0) as write:
        for picture in _board("charuco:9x6:30mm:22mm:DICT_4X4_50", "fisheye", 14):
            for _ in range(3):
                write(np.repeat(picture[..., None], 3, axis=2))


def _toml(page: str, number: int) -> Callable[[Path], None]:
    return lambda path: path.write_text(toml_of(page)[number], encoding="utf-8") and None


def cat_file(path: Path) -> None:
    path.write_text(CAT.read_text(encoding="utf-8"), encoding="utf-8")


def _cat(folder: Path, seed: int = 0) -> tuple[Body, Pose3D]:
    """Return the body of the cat of writing-a-skeleton.md, and 400 frames of its motion.

    All angles follow slow waves while the cat trots past at 3 m/s.
    """
    file = folder / "my-cat.toml"
    if not file.exists():
        cat_file(file)
    body = load_skeleton(str(file))
    rng, time_s = np.random.default_rng(seed), np.arange(400) / CAT_FPS
    states = np.zeros((400, body.n_state))
    waves = np.sin(2 * np.pi * 2.5 * time_s[:, None] + rng.uniform(0, 6, len(body.mean_rad)))
    states[:, 0], states[:, 2], states[:, 4:] = 3 * time_s - 3, 0.3, body.mean_rad + 0.6 * body.sigma_rad * waves
    return body, Pose3D(body.markers, body.tree.pose(states).points_m, np.arange(400), fps=CAT_FPS)


def _cat_clip(path: Path) -> None:
    """Write the keypoints of the cat, as seen by the samples' camera from a smaller distance."""
    _, truth = _cat(path.parent, seed=1)
    camera = read_camera(SAMPLES / "camera.toml")
    near = truth.xyz_m[70:130] + camera.centre_world + camera.rotation[2] * 6 - [0, 0, 0.3]
    xy_px, seen = camera.project(camera.world_to_camera(near))
    xy_px = np.where(seen[..., None], xy_px, np.nan)
    clip = Keypoints(truth.names, xy_px, seen.astype(float), np.arange(60), fps=CAT_FPS)
    write_csv(clip, path)


FILES: dict[str, Callable[[Path], None]] = {
    "track.csv": _track,
    "clip.csv": sample("whole.csv"),
    "camera.toml": sample("camera.toml"),
    "truth.csv": sample("whole_truth.csv"),
    "poses.csv": sample("whole_truth.csv"),
    "clips": _clips,
    "clip.analysis.h5": _sleap,
    "pair.h5": _two_animals,
    "capture.bvh": _bvh,
    "long.csv": _long,
    "wide.csv": _wide,
    "board": _pictures,
    "board.mp4": _board_video,
    "run1.csv": _runs,
    "run2.csv": _runs,
    "my-dog.toml": lambda path: Path(
        shutil.copy(ROOT / "recon" / "animal" / "skeletons" / "cheetah-24.toml", path)
    ).touch(),
    "data/samples/whole.csv": sample("whole.csv"),
    "data/samples/whole_truth.csv": sample("whole_truth.csv"),
    "data/samples/noisy.csv": sample("noisy.csv"),
    "data/samples/camera.toml": sample("camera.toml"),
}
"""Function that makes each file that a page names but does not make itself, by file name."""

OF_PAGE: dict[str, dict[str, Callable[[Path], None]]] = {
    "batch.md": {
        "day1/run2-cam*.csv": lambda path: _filmed_twice(path.parent, "run2"),
        "recordings": lambda path: _filmed_twice(path, "walk"),
        "scene.json": sample("whole_scene.json"),
    },
    "how-to/audit.md": {"poses.csv": _in_mm},
    "how-to/moving-camera.md": {"clip.csv": _first(30)},
    "how-to/scale.md": {"clip.csv": _first(30)},
    "how-to/uncalibrated.md": {"clip.csv": _first(30)},
    "how-to/other-formats.md": {
        "clip.analysis.h5": _of_other_names,
        "results_clip.json": lambda path: write_mmpose(path, read_keypoints(SAMPLES / "whole.csv")),
    },
    "how-to/new-species.md": {"my-cat.toml": cat_file},
    "method/published-study.md": {"clip.csv": _first(20)},
    "solver.md": {"clip.csv": _first(20)},
    "robot.md": {"arm.toml": _toml("robot.md", 0)},
    "writing-a-skeleton.md": {
        "my-cat.toml": cat_file,
        "clip.csv": _cat_clip,
    },
}
"""Function that makes each file whose name stands for another file on one page, by page and file name."""
