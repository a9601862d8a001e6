"""Measure the numbers in the skeleton dog-27, and its errors when it is reconstructed from one side view.

    python benchmarks/parts/dog.py [FOLDER] [--only lengths|expectations|accuracy] [--write-prior dog.npz]

FOLDER holds optical motion capture of one dog: a file *_joint_pos.txt for each clip, with a row per frame and x y z of
every joint, metres, y up; and joints.json with the joints' names and parents and the frame rate. By default it is the
dog-mocap of $RECON_SHARED_DATA, or of ../shared/data.

For the part `accuracy`, each clip is seen by one static, level pinhole camera, 1920x1080, 0.6 m above the ground, 6 m
to the side of the clip's path. Its field of view is the smallest whole number of degrees that contains the whole clip.
Detections are the joints' projections with 2 px of Gaussian noise. The prior is learned from the other seven clips. All
clips show the same dog, and the fits use its lengths. The script runs in one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from arguments import parser_of
from trajectory import print_table

from recon import Body, Camera, FitSettings, Pose3D, fit_clip, load_skeleton, write_camera
from recon.animal.measured import save_prior
from recon.animal.prior import prior_from_body
from recon.api.model_settings import PriorFitSettings
from recon.api.prior_fit import run_prior_fit
from recon.fit import constants
from recon.fit.points import solve_points
from recon.fit.result import TrajectorySolution
from recon.gait.evaluation import aligned, joint_errors, score
from recon.gait.gait import Gait, gait
from recon.gait.stances import pose_tracks

SKELETON = "dog-27"
WIDEN = 1.5
"""Factor by which the expected standard deviations exceed those measured in the clips."""
LEAST_SIGMA_RAD, LEAST_RAD_S2 = 0.05, 20.0
DISTANCE_M, HEIGHT_M, MARGIN_PX, NOISE_PX = 6.0, 0.6, 20.0, 2.0
IMAGE_SIZE_PX = (1920, 1080)
SOURCE = (
    "statistics of eight clips of one dog's motion capture that were published with Zhang et al. 2018, "
    "Mode-adaptive neural networks for quadruped motion control (CC BY-NC 4.0)"
)
_WORLD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotation from axes with y up to axes with z up: x = the file's z, y = its x, z = its y. Both are right-handed."""
_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation of a level camera that looks along y."""

Rows = list[dict]


@dataclass(frozen=True, eq=False)
class Clip:
    """A clip of a dog's motion capture, with T frames and J joints."""

    name: str
    names: tuple[str, ...]
    """Names of the J joints."""
    parents: tuple[int, ...]
    fps: float
    points_m: np.ndarray
    """Joints in a world with z up, shape (T, J, 3), metres."""

    def markers(self, body: Body) -> np.ndarray:
        return self.points_m[:, [self.names.index(marker) for marker in body.markers]]


def read_clips(folder: Path) -> list[Clip]:
    about = json.loads((folder / "joints.json").read_text())
    assert (about["units"], about["up"]) == ("m", "+Y")
    J = len(about["joints"])
    found = []
    for path in sorted(folder.glob("*_joint_pos.txt")):
        rows = np.loadtxt(path, delimiter=",", usecols=range(3 * J)).reshape(-1, J, 3)
        name = path.name.removeprefix("dog_").removesuffix("_joint_pos.txt")
        found.append(Clip(name, tuple(about["joints"]), tuple(about["parents"]), about["fps"], rows @ _WORLD.T))
    return found


def body_of() -> Body:
    return load_skeleton(SKELETON)


def marker_gait(clip: Clip) -> Gait:
    """Return the gait computed from a clip's markers."""
    body = body_of()
    pose = Pose3D(body.markers, clip.markers(body), np.arange(len(clip.points_m)))
    return gait(pose_tracks(pose, clip.fps, feet=body.feet_by_label(), body=body.forward))


def lengths(clips: Sequence[Clip]) -> Rows:
    """Measure how much the distances from joint to parent, and within chest and pelvis, vary over the clips."""
    names = clips[0].names
    pairs = [(names[p], n) for n, p in zip(names, clips[0].parents, strict=True) if p >= 0]
    pairs += [
        *(("LeftShoulder", "RightShoulder"), ("Neck", "LeftShoulder"), ("Neck", "RightShoulder")),
        *(("LeftUpLeg", "RightUpLeg"), ("LeftUpLeg", "Tail"), ("RightUpLeg", "Tail")),
    ]
    body = body_of()
    at = dict(zip(body.markers, _mean_points(body), strict=True))
    rows = []
    for a, b in pairs:
        apart = [_apart(clip, a, b) for clip in clips]
        rows.append(
            {
                "from": a,
                "to": b,
                "median m": float(np.median([np.median(d) for d in apart])),
                "spread over frames mm": 1000 * max(float(d.std()) for d in apart),
                "spread over clips mm": 1000 * float(np.std([np.median(d) for d in apart])),
                f"{SKELETON} m": float(np.linalg.norm(at[a] - at[b])),
            }
        )
    return rows


def _apart(clip: Clip, a: str, b: str) -> np.ndarray:
    return np.linalg.norm(clip.points_m[:, clip.names.index(a)] - clip.points_m[:, clip.names.index(b)], axis=1)


def _mean_points(body: Body) -> np.ndarray:
    return body.tree.pose(np.concatenate([np.zeros(4), body.mean_rad])[None]).points_m[0]


@dataclass(frozen=True, eq=False)
class SegmentFit:
    """The skeleton fitted to a clip."""

    clip: Clip
    states: np.ndarray
    """States of the skeleton, shape (T, D)."""
    rms_m: np.ndarray
    """Root mean square distance of the skeleton's markers from the recorded ones, shape (T,)."""


def solve(clips: Sequence[Clip]) -> list[SegmentFit]:
    body = body_of()
    return [SegmentFit(clip, *solve_points(body, clip.markers(body))[:2]) for clip in clips]


def expected(solved: Sequence[SegmentFit]) -> Body:
    """Return the skeleton with the means and widened standard deviations of its angles in the clips.

    Each clip counts a second time, mirrored left to right.
    """
    body = body_of()
    permutation, sign = body.mirror
    states = np.concatenate([one.states for one in solved])
    accelerations = np.concatenate([np.diff(one.states, n=2, axis=0) * one.clip.fps**2 for one in solved])
    poses, bends = (np.concatenate([x, x[:, permutation] * sign])[:, 4:] for x in (states, accelerations))
    return replace(
        body,
        mean_rad=poses.mean(axis=0),
        sigma_rad=np.maximum(WIDEN * poses.std(axis=0), LEAST_SIGMA_RAD),
        acceleration_rad_s2=np.maximum(WIDEN * bends.std(axis=0), LEAST_RAD_S2),
    )


def expectations(solved: Sequence[SegmentFit]) -> Rows:
    """Compare the expectations of each angle measured in the clips with the values of the skeleton's file."""
    file, found = body_of(), expected(solved)
    fields = ("mean_rad", "sigma_rad", "acceleration_rad_s2")
    return [
        {"angle": name} | {f"{who} {field}": float(getattr(body, field)[i]) for field in fields for who, body in both}
        for both in [(("measured", found), ("file", file))]
        for i, name in enumerate(file.state_names[4:])
        if not name.startswith("r_")
    ]


def misfits(solved: Sequence[SegmentFit]) -> Rows:
    return [
        {
            "clip": one.clip.name,
            "frames": len(one.states),
            "misfit median mm": 1000 * float(np.median(one.rms_m)),
            "misfit largest mm": 1000 * float(one.rms_m.max()),
        }
        for one in solved
    ]


def side_view(clip: Clip, reference: str = "Hips") -> tuple[Camera, float]:
    """Return a camera at the side of the path of the joint `reference`, and its horizontal field of view in degrees."""
    hips = clip.points_m[:, clip.names.index(reference)]
    middle = (hips[:, 0].min() + hips[:, 0].max()) / 2
    return narrowest(clip.points_m, np.array([middle, np.median(hips[:, 1]) - DISTANCE_M, HEIGHT_M]))


def narrowest(points_m: np.ndarray, centre_m: np.ndarray) -> tuple[Camera, float]:
    """Return the narrowest level camera at a position, looking along y, whose picture contains all points (T, J, 3)."""
    for hfov_deg in range(10, 120):
        camera = Camera.from_hfov(hfov_deg, IMAGE_SIZE_PX)
        camera = replace(camera, rotation=_CAMERA, translation_m=-_CAMERA @ centre_m)
        px, valid = camera.project(camera.world_to_camera(points_m))
        if valid.all() and (px > MARGIN_PX).all() and (px < np.array(IMAGE_SIZE_PX) - MARGIN_PX).all():
            return camera, float(hfov_deg)
    raise ValueError("the clip does not fit into a picture")


def write_view(
    clip: Clip, folder: Path, seed: int, skeleton: str = SKELETON, reference: str = "Hips", as_stated: bool = False
) -> tuple[FitSettings, float]:
    """Write detections and camera as files, and return the settings that read them and the field of view, degrees.

    If `as_stated`, keypoints have the bias and jitter that the skeleton states for a detector.
    """
    camera, hfov_deg = side_view(clip, reference)
    in_camera_m = camera.world_to_camera(clip.points_m)
    px, _ = camera.project(in_camera_m)
    rng = np.random.default_rng(seed)
    px += rng.normal(0, NOISE_PX, px.shape)
    if as_stated:
        off = rng.standard_normal(px.shape)
        # Correlate neighbouring frames, so that errors last for `ERROR_TIME_S`.
        stays = np.exp(-2 / (constants.ERROR_TIME_S * clip.fps))
        for before, now in pairwise(off):
            now[:] = stays * before + (1 - stays**2) ** 0.5 * now
        off *= (1 - constants.KEYPOINT_BIAS_SHARE**2) ** 0.5
        off += constants.KEYPOINT_BIAS_SHARE * rng.standard_normal(px.shape[1:])
        px += load_skeleton(skeleton).keypoint_sigma_m * camera.matrix[0, 0] / in_camera_m[..., 2:] * off
    table = np.concatenate([px, np.ones((*px.shape[:2], 1))], axis=2).reshape(len(px), -1)
    columns = pd.MultiIndex.from_product(
        [["simulated"], clip.names, ["x", "y", "likelihood"]], names=["scorer", "bodyparts", "coords"]
    )
    pd.DataFrame(table, columns=columns).to_csv(folder / f"{clip.name}.csv")
    write_camera(camera, folder / f"{clip.name}.toml")
    settings = FitSettings(
        keypoints=(folder / f"{clip.name}.csv",),
        camera=(folder / f"{clip.name}.toml",),
        fps=clip.fps,
        skeleton=skeleton,
    )
    return settings, hfov_deg


def fit_row(clip: Clip, prior: str, folder: Path, seed: int) -> dict:
    settings, hfov_deg = write_view(clip, folder, seed)
    motion = fit_clip(replace(settings, prior=prior))
    solution, truth_m = motion.solution, motion.camera.world_to_camera(clip.markers(motion.solution.body))
    assert isinstance(solution, TrajectorySolution)
    found_m = solution.joints_camera_m
    centred = score(joint_errors(aligned(found_m, truth_m), truth_m))
    return {
        "clip": clip.name,
        "frames": len(truth_m),
        "hfov_deg": hfov_deg,
        "status": solution.status,
        "mpjpe_mm": 1000 * centred.mean,
        "mpe_mm": 1000 * score(joint_errors(found_m, truth_m)).mean,
        "pa_mpjpe_mm": 1000 * score(joint_errors(aligned(found_m, truth_m, scale=True, turn=True), truth_m)).mean,
        "95 % of frames below mm": 1000 * float(np.percentile(centred.per_frame, 95)),
        "worst frame mm": 1000 * float(centred.per_frame.max()),
        "frames flagged": sum(map(bool, solution.flags)),
        "solve_s": solution.stage_s["all"],
    }


def write_poses(clips: Sequence[Clip], folder: Path) -> list[Path]:
    """Write poses as files for `recon prior fit`."""
    paths = []
    for clip in clips:
        columns = pd.MultiIndex.from_product([clip.names, ["x", "y", "z"]], names=["bodyparts", "coords"])
        paths.append(folder / f"{clip.name}_pose3d.csv")
        pd.DataFrame(clip.points_m.reshape(len(clip.points_m), -1), columns=columns).to_csv(paths[-1])
    return paths


def write_prior(clips: Sequence[Clip], out: Path) -> Path:
    with tempfile.TemporaryDirectory() as folder:
        poses = write_poses(clips, Path(folder))
        run_prior_fit(
            PriorFitSettings(
                poses=tuple(poses),
                out=out,
                skeleton=SKELETON,
                fps=f"{clips[0].fps:g}",
                name=out.stem,
                source=SOURCE,
                overwrite=True,
            )
        )
    return out


def accuracy(clips: Sequence[Clip], solved: Sequence[SegmentFit]) -> dict[str, Rows]:
    tables: dict[str, Rows] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for title in ("prior from the other clips", "each angle on its own, from the other clips"):
            rows = []
            for i, clip in enumerate(clips):
                others = [one for one in solved if one.clip is not clip]
                file = folder / "prior.npz"
                if title.startswith("prior"):
                    write_prior([one.clip for one in others], file)
                else:
                    save_prior(prior_from_body(expected(others)), file)
                rows.append(fit_row(clip, str(file), folder, seed=i))
            tables[title] = [*rows, _median(rows)]
    return tables


def _median(rows: Rows) -> dict:
    numbers = [name for name, value in rows[0].items() if isinstance(value, int | float)]
    middle = {name: float(np.median([row[name] for row in rows])) for name in numbers}
    converged = sum(row["status"] == "converged" for row in rows)
    return {"clip": "median", **middle, "status": f"{converged} of {len(rows)} converged"}


def main() -> None:
    parser = parser_of(__doc__, kind="dog-mocap", only=("lengths", "expectations", "accuracy"))
    parser.add_argument("--write-prior", type=Path, help="fit a prior to all clips and write it here; no tables")
    arguments = parser.parse_args()

    if not (arguments.folder / "joints.json").is_file():
        parser.exit(2, f"no joints.json in {arguments.folder}\n")
    clips = read_clips(arguments.folder)
    if arguments.write_prior:
        print(f"written: {write_prior(clips, arguments.write_prior)}")
        return
    if "lengths" in arguments.only:
        print_table("lengths", lengths(clips))
    if arguments.only == ["lengths"]:
        return
    solved = solve(clips)
    if "expectations" in arguments.only:
        print_table("the skeleton's misfit to the clips", misfits(solved))
        print_table("expectations of the angles", expectations(solved))
    if "accuracy" in arguments.only:
        for title, rows in accuracy(clips, solved).items():
            print_table(title, rows)


if __name__ == "__main__":
    main()
