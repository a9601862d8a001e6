"""Write the sample of a whole cheetah in the file formats and keypoint names of other programs' detectors.

Each file has the names and the layout of the detector's program: DeepLabCut 3 (`video_inference_superanimal`, the 2D
file of FMPose3D, a project of one animal), AP-10K annotations, and MMPose's demo for a video. Keypoints that the sample
lacks are placed in the middle of its keypoints, so that a wrong assignment is noticed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from recon.animal.naming import load_names
from recon.base.arrays import Array
from recon.clip import Keypoints


def split_names(*lines: str) -> tuple[str, ...]:
    """Return the names in comma-separated strings."""
    return tuple(word.strip() for line in lines for word in line.split(","))


SUPERANIMAL = split_names(
    "nose,upper_jaw,lower_jaw,mouth_end_right,mouth_end_left,right_eye,right_earbase,right_earend,right_antler_base",
    "right_antler_end,left_eye,left_earbase,left_earend,left_antler_base,left_antler_end,neck_base,neck_end,throat_base",
    "throat_end,back_base,back_end,back_middle,tail_base,tail_end,front_left_thai,front_left_knee,front_left_paw",
    "front_right_thai,front_right_knee,front_right_paw,back_left_paw,back_left_thai,back_right_thai,back_left_knee",
    "back_right_knee,back_right_paw,belly_bottom,body_middle_right,body_middle_left",
)
AP_10K = split_names(
    "left_eye,right_eye,nose,neck,root_of_tail,left_shoulder,left_elbow,left_front_paw,right_shoulder,right_elbow",
    "right_front_paw,left_hip,left_knee,left_back_paw,right_hip,right_knee,right_back_paw",
)
MMPOSE_AP_10K = split_names(
    "L_Eye,R_Eye,Nose,Neck,Root of tail,L_Shoulder,L_Elbow,L_F_Paw,R_Shoulder,R_Elbow,R_F_Paw,L_Hip,L_Knee,L_B_Paw",
    "R_Hip,R_Knee,R_B_Paw",
)
ANIMAL3D = split_names(
    "left_eye,right_eye,mouth_mid,left_front_paw,right_front_paw,left_back_paw,right_back_paw,tail_base",
    "left_front_thigh,right_front_thigh,left_back_thigh,right_back_thigh,left_shoulder,right_shoulder,left_front_knee",
    "right_front_knee,left_back_knee,right_back_knee,neck,tail_end,left_ear,right_ear,left_mouth,right_mouth,nose",
    "tail_mid",
)
ACINOSET = split_names(
    "r_eye,l_eye,nose,neck_base,spine,tail_base,tail1,tail2,r_shoulder,r_front_knee,r_front_ankle,r_front_paw,r_hip",
    "r_back_knee,r_back_ankle,r_back_paw,l_shoulder,l_front_knee,l_front_ankle,l_front_paw,l_hip,l_back_knee",
    "l_back_ankle,l_back_paw,lure",
)
HORSE_10 = split_names(
    "Nose,Eye,Nearknee,Nearfrontfetlock,Nearfrontfoot,Offknee,Offfrontfetlock,Offfrontfoot,Shoulder,Midshoulder,Elbow",
    "Girth,Wither,Nearhindhock,Nearhindfetlock,Nearhindfoot,Hip,Stifle,Offhindhock,Offhindfetlock,Offhindfoot,Ischium",
)
UNSEEN_FRAME = 10
"""Frame in which no detector detects the animal."""


def detect(sample: Keypoints, names: Sequence[str], bundled: str | None) -> Array:
    """Return the sample's keypoints as a detector with other keypoint names would detect them.

    Parameters
    ----------
    sample
        Keypoints of `whole.csv`.
    names
        Names of the K keypoints of the detector.
    bundled
        Name of the bundled map from these names to the sample's names; None if the names are the same.

    Returns
    -------
    Array
        x and y in pixels and likelihood, shape (T, K, 3); NaN in the frame `UNSEEN_FRAME`.
    """
    renamed = {} if bundled is None else load_names(bundled)
    values = np.empty((len(sample.frames), len(names), 3))
    values[:] = np.append(np.nanmean(sample.xy_px, axis=(0, 1)), 0.95)
    values[..., :2] = np.nanmean(sample.xy_px, axis=1, keepdims=True)
    for k, name in enumerate(names):
        if (new := renamed.get(name, name)) in sample.names:
            j = sample.names.index(new)
            values[:, k] = np.column_stack([sample.xy_px[:, j], sample.confidence[:, j]])
    values[UNSEEN_FRAME] = np.nan
    return values


def write_deeplabcut(path: Path, names: Sequence[str], values: Array, scorer: str, padding: float) -> None:
    """Write a DeepLabCut 3 table of the sample's animal and of two animals whose cells are `padding`."""
    import pandas as pd

    levels = [[scorer], ["animal0", "animal1", "animal2"], list(names), ["x", "y", "likelihood"]]
    columns = pd.MultiIndex.from_product(levels, names=["scorer", "individuals", "bodyparts", "coords"])
    animals = np.full((len(values), 3, *values.shape[1:]), padding)
    animals[:, 0] = np.where(np.isnan(values[..., :1]), padding, values)
    table = pd.DataFrame(animals.reshape(len(values), -1), columns=columns)
    if path.suffix == ".csv":
        table.to_csv(path)
    else:
        table.to_hdf(path, key="df_with_missing", format="table", mode="w")


def write_superanimal(path: Path, sample: Keypoints) -> None:
    """Write the sample in the layout and names of DeepLabCut 3's SuperAnimal-Quadruped."""
    values = detect(sample, SUPERANIMAL, "superanimal-quadruped")
    scorer = "superanimal_quadruped_hrnet_w32_fasterrcnn_resnet50_fpn_v2"
    write_deeplabcut(path, SUPERANIMAL, values, scorer, padding=-1.0)


def write_fmpose3d(path: Path, sample: Keypoints) -> None:
    """Write the sample in the layout and names of FMPose3D's 2D file."""
    write_deeplabcut(path, ANIMAL3D, detect(sample, ANIMAL3D, "animal3d"), "DLC_fmpose3d_animals", padding=0.0)


def write_acinoset(path: Path, sample: Keypoints) -> None:
    """Write the sample as DeepLabCut 2 does for a project of one animal."""
    import pandas as pd

    values = detect(sample, ACINOSET, None)
    scorer = "DLC_resnet152_CheetahOct14shuffle4_500000"
    levels = [[scorer], list(ACINOSET), ["x", "y", "likelihood"]]
    columns = pd.MultiIndex.from_product(levels, names=["scorer", "bodyparts", "coords"])
    pd.DataFrame(values.reshape(len(values), -1), columns=columns).to_csv(path)


def write_ap_10k(path: Path, sample: Keypoints) -> None:
    """Write the sample as AP-10K annotations of a video's frames, in which all species have the same keypoints."""
    values = detect(sample, AP_10K, "ap-10k")
    species = [{"id": i, "name": name, "supercategory": "Felidae", "keypoints": AP_10K, "skeleton": [[1, 2], [1, 3]]}
               for i, name in enumerate(("cheetah", "lion"), start=19)]  # fmt: skip
    images, labels = [], []
    for t, points in enumerate(values):
        number, seen = t + 1, np.isfinite(points[:, 0])
        images.append({"id": number, "file_name": f"{t:012}.jpg", "width": 1920, "height": 1080, "license": 1})
        flat = np.where(seen[:, None], np.column_stack([points[:, :2], np.full(len(points), 2)]), 0).ravel().tolist()
        box = {"bbox": [0, 0, 9, 9], "area": 81, "iscrowd": 0, "num_keypoints": int(seen.sum())}
        if seen.any():
            labels.append({"id": number, "image_id": number, "category_id": 19, "keypoints": flat, **box})
    info = {"description": "AP-10k", "version": "1.0", "year": 2021}
    content = {"info": info, "licenses": [], "images": images, "annotations": labels, "categories": species}
    path.write_text(json.dumps(content), encoding="utf-8")


def write_mmpose(path: Path, sample: Keypoints) -> None:
    """Write the sample as MMPose's `topdown_demo_with_mmdet.py --save-predictions` does for a video."""
    values = detect(sample, MMPOSE_AP_10K, "ap-10k")
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
            if t != UNSEEN_FRAME
            else [],
        }
        for t, points in enumerate(values)
    ]
    path.write_text(json.dumps({"meta_info": meta, "instance_info": frames}, indent="\t"), encoding="utf-8")


FILES: dict[str, tuple[str | None, Callable[[Path, Keypoints], None]]] = {
    "superanimal.csv": ("superanimal-quadruped", write_superanimal),
    "superanimal.h5": ("superanimal-quadruped", write_superanimal),
    "fmpose3d.h5": ("animal3d", write_fmpose3d),
    "ap-10k.json": ("ap-10k", write_ap_10k),
    "mmpose.json": ("ap-10k", write_mmpose),
    "acinoset.csv": (None, write_acinoset),
}
"""Bundled map of names, and writer, for each file by its name."""
