"""The sample of a whole cheetah in the files of others' detectors, and how good a fit of each is.

python benchmarks/detector_files.py

Each file has the names and the layout that the detector's program writes: DeepLabCut 3 (`video_inference_superanimal`,
FMPose3D's 2D, a project of one animal), the annotations of AP-10K, and what MMPose's demo saves of a video. Keypoints
that the sample has not lie in the middle of the others, so that taking one for another would show.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from markdown_table import print_header, print_row

from recon import FitSettings, Pose3D, evaluate, fit_clip, read_pose3d
from recon.animal.naming import load_names
from recon.io import read_keypoints

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"


def words(*lines: str) -> tuple[str, ...]:
    return tuple(word.strip() for line in lines for word in line.split(","))


SUPERANIMAL = words(
    "nose,upper_jaw,lower_jaw,mouth_end_right,mouth_end_left,right_eye,right_earbase,right_earend,right_antler_base",
    "right_antler_end,left_eye,left_earbase,left_earend,left_antler_base,left_antler_end,neck_base,neck_end,throat_base",
    "throat_end,back_base,back_end,back_middle,tail_base,tail_end,front_left_thai,front_left_knee,front_left_paw",
    "front_right_thai,front_right_knee,front_right_paw,back_left_paw,back_left_thai,back_right_thai,back_left_knee",
    "back_right_knee,back_right_paw,belly_bottom,body_middle_right,body_middle_left",
)
AP_10K = words(
    "left_eye,right_eye,nose,neck,root_of_tail,left_shoulder,left_elbow,left_front_paw,right_shoulder,right_elbow",
    "right_front_paw,left_hip,left_knee,left_back_paw,right_hip,right_knee,right_back_paw",
)
MMPOSE_AP_10K = words(
    "L_Eye,R_Eye,Nose,Neck,Root of tail,L_Shoulder,L_Elbow,L_F_Paw,R_Shoulder,R_Elbow,R_F_Paw,L_Hip,L_Knee,L_B_Paw",
    "R_Hip,R_Knee,R_B_Paw",
)
ANIMAL3D = words(
    "left_eye,right_eye,mouth_mid,left_front_paw,right_front_paw,left_back_paw,right_back_paw,tail_base",
    "left_front_thigh,right_front_thigh,left_back_thigh,right_back_thigh,left_shoulder,right_shoulder,left_front_knee",
    "right_front_knee,left_back_knee,right_back_knee,neck,tail_end,left_ear,right_ear,left_mouth,right_mouth,nose",
    "tail_mid",
)
ACINOSET = words(
    "r_eye,l_eye,nose,neck_base,spine,tail_base,tail1,tail2,r_shoulder,r_front_knee,r_front_ankle,r_front_paw,r_hip",
    "r_back_knee,r_back_ankle,r_back_paw,l_shoulder,l_front_knee,l_front_ankle,l_front_paw,l_hip,l_back_knee",
    "l_back_ankle,l_back_paw,lure",
)
HORSE_10 = words(
    "Nose,Eye,Nearknee,Nearfrontfetlock,Nearfrontfoot,Offknee,Offfrontfetlock,Offfrontfoot,Shoulder,Midshoulder,Elbow",
    "Girth,Wither,Nearhindhock,Nearhindfetlock,Nearhindfoot,Hip,Stifle,Offhindhock,Offhindfetlock,Offhindfoot,Ischium",
)
UNSEEN = 10
"""A frame in which no detector sees the animal."""


def detected(names: Sequence[str], bundled: str | None) -> np.ndarray:
    """(T, K, 3): x, y and likelihood of the sample's keypoints under these names; NaN where it has none."""
    file, of = read_keypoints(SAMPLES / "whole.csv"), {} if bundled is None else load_names(bundled)
    values = np.empty((len(file.frames), len(names), 3))
    values[:] = np.append(np.nanmean(file.xy_px, axis=(0, 1)), 0.95)
    values[..., :2] = np.nanmean(file.xy_px, axis=1, keepdims=True)
    for k, name in enumerate(names):
        if (new := of.get(name, name)) in file.names:
            j = file.names.index(new)
            values[:, k] = np.column_stack([file.xy_px[:, j], file.confidence[:, j]])
    values[UNSEEN] = np.nan
    return values


def deeplabcut(path: Path, names: Sequence[str], values: np.ndarray, scorer: str, padding: float) -> None:
    """A table of three animals, the first of which is the sample's, as DeepLabCut 3 writes it. padding: of an animal
    that it did not see."""
    import pandas as pd

    levels = [[scorer], ["animal0", "animal1", "animal2"], list(names), ["x", "y", "likelihood"]]
    columns = pd.MultiIndex.from_product(levels, names=["scorer", "individuals", "bodyparts", "coords"])
    everyone = np.full((len(values), 3, *values.shape[1:]), padding)
    everyone[:, 0] = np.where(np.isnan(values[..., :1]), padding, values)
    table = pd.DataFrame(everyone.reshape(len(values), -1), columns=columns)
    if path.suffix == ".csv":
        table.to_csv(path)
    else:
        table.to_hdf(path, key="df_with_missing", format="table", mode="w")


def superanimal(path: Path) -> None:
    values = detected(SUPERANIMAL, "superanimal-quadruped")
    scorer = "superanimal_quadruped_hrnet_w32_fasterrcnn_resnet50_fpn_v2"
    deeplabcut(path, SUPERANIMAL, values, scorer, padding=-1.0)


def fmpose3d(path: Path) -> None:
    deeplabcut(path, ANIMAL3D, detected(ANIMAL3D, "animal3d"), "DLC_fmpose3d_animals", padding=0.0)


def acinoset(path: Path) -> None:
    """A file of one animal, as DeepLabCut 2 writes it."""
    import pandas as pd

    values = detected(ACINOSET, None)
    scorer = "DLC_resnet152_CheetahOct14shuffle4_500000"
    levels = [[scorer], list(ACINOSET), ["x", "y", "likelihood"]]
    columns = pd.MultiIndex.from_product(levels, names=["scorer", "bodyparts", "coords"])
    pd.DataFrame(values.reshape(len(values), -1), columns=columns).to_csv(path)


def ap_10k(path: Path) -> None:
    """Annotations of a video's frames: every species has the same keypoints."""
    values = detected(AP_10K, "ap-10k")
    species = [{"id": i, "name": name, "supercategory": "Felidae", "keypoints": AP_10K, "skeleton": [[1, 2], [1, 3]]}
               for i, name in enumerate(("cheetah", "lion"), start=19)]  # fmt: skip
    images, annotations = [], []
    for t, points in enumerate(values):
        number, seen = t + 1, np.isfinite(points[:, 0])
        images.append({"id": number, "file_name": f"{t:012}.jpg", "width": 1920, "height": 1080, "license": 1})
        flat = np.where(seen[:, None], np.column_stack([points[:, :2], np.full(len(points), 2)]), 0).ravel().tolist()
        box = {"bbox": [0, 0, 9, 9], "area": 81, "iscrowd": 0, "num_keypoints": int(seen.sum())}
        if seen.any():
            annotations.append({"id": number, "image_id": number, "category_id": 19, "keypoints": flat, **box})
    info = {"description": "AP-10k", "version": "1.0", "year": 2021}
    content = {"info": info, "licenses": [], "images": images, "annotations": annotations, "categories": species}
    path.write_text(json.dumps(content), encoding="utf-8")


def mmpose(path: Path) -> None:
    """What `topdown_demo_with_mmdet.py --save-predictions` saves of a video."""
    values = detected(MMPOSE_AP_10K, "ap-10k")
    values = np.where(np.isnan(values), 0.0, values)
    meta = {"dataset_name": "ap10k", "num_keypoints": 17, "keypoint_id2name": dict(enumerate(MMPOSE_AP_10K))}
    frames = [
        {
            "frame_id": t + 1,
            "instances": [
                {
                    "keypoints": points[:, :2].tolist(),
                    "keypoint_scores": points[:, 2].tolist(),
                    "bbox": [[0.0, 0.0, 9.0, 9.0]],
                    "bbox_score": 0.9,
                }
            ]
            if t != UNSEEN
            else [],
        }
        for t, points in enumerate(values)
    ]
    path.write_text(json.dumps({"meta_info": meta, "instance_info": frames}, indent="\t"), encoding="utf-8")


FILES: dict[str, tuple[str | None, Callable[[Path], None]]] = {
    "superanimal.csv": ("superanimal-quadruped", superanimal),
    "superanimal.h5": ("superanimal-quadruped", superanimal),
    "fmpose3d.h5": ("animal3d", fmpose3d),
    "ap-10k.json": ("ap-10k", ap_10k),
    "mmpose.json": ("ap-10k", mmpose),
    "acinoset.csv": (None, acinoset),
}
"""Each with its map."""


def mpjpe_m(keypoints: Path, rename: str | None = None, skeleton: str = "cheetah-24") -> tuple[float, int]:
    """The error of a fit, over all joints of the skeleton that the truth has; and how many of them the file has."""
    camera = SAMPLES / "camera.toml"
    detector = "acinoset" if skeleton == "cheetah-24" else None  # the sample's, under whatever names
    given = {"camera": camera, "fps": 60.0, "rename": rename, "skeleton": skeleton, "detector": detector}
    motion = fit_clip(FitSettings(keypoints=(keypoints,), **given))
    pose = Pose3D(motion.names, motion.joints_m, motion.frames)
    error = evaluate(pose, read_pose3d(SAMPLES / "whole_truth.csv")).mpjpe_m.mean
    return error, len(motion.names) - len(motion.missing_keypoints)


def main() -> None:
    print_header(["file", "`--rename`", "of the skeleton's 24", "MPJPE, mm", "of the skeleton's own names"])
    native, used = mpjpe_m(SAMPLES / "whole.csv")
    print_row(["whole.csv", "", used, f"{1000 * native:.0f}", 1])
    with tempfile.TemporaryDirectory() as folder:
        for name, (bundled, write) in FILES.items():
            write(Path(folder) / name)
            error, used = mpjpe_m(Path(folder) / name, bundled)
            print_row([name, bundled or "", used, f"{1000 * error:.0f}", f"{error / native:.2f}"])
        error, _ = mpjpe_m(Path(folder) / "superanimal.csv", "superanimal-quadruped", "quadruped")
        print(f"\n`superanimal.csv` with `--skeleton quadruped`: {1000 * error:.0f} mm.")


if __name__ == "__main__":
    main()
