"""Metric 3D motion of a running animal from one camera and DeepLabCut keypoints.

import recon

settings = recon.FitSettings(keypoints="clip.csv", camera="camera.toml", fps=120)
motion = recon.fit_clip(settings)
motion.joints_m  # (frames, joints, 3), metres"""

import logging
from typing import TYPE_CHECKING, Any

from recon.base import lazily

if TYPE_CHECKING:
    from recon.animal.body import Body
    from recon.animal.skeleton_file import load_skeleton
    from recon.base.errors import InputError
    from recon.clip import Keypoints, clean
    from recon.fit.motion import Motion
    from recon.gait.clip import ClipAnalysis, analyse
    from recon.gait.evaluation import Evaluation, evaluate, evaluate_files
    from recon.geometry.camera import Camera
    from recon.io import Pose3D, read_camera, read_cameras, read_keypoints, read_pose3d, write_camera, write_cameras
    from recon.wings.keypoint_net.labels import LabelSource
    from recon.wings.keypoint_net.network import run_prediction
    from recon.wings.keypoint_net.train import TrainSettings, run_training
    from recon.workflows.batch import find_clips, plan_batch, run_batch
    from recon.workflows.calibrate import CalibrationSettings, run_calibration
    from recon.workflows.clip import fit_clip
    from recon.workflows.clip_results import write_clip
    from recon.workflows.config import read_settings
    from recon.workflows.demo import samples_folder
    from recon.workflows.models import PriorFitSettings, SubjectFitSettings, run_prior_fit, run_subject_fit
    from recon.workflows.settings import FitSettings

    __version__: str

__all__ = [
    "Body",
    "CalibrationSettings",
    "Camera",
    "ClipAnalysis",
    "Evaluation",
    "FitSettings",
    "InputError",
    "Keypoints",
    "LabelSource",
    "Motion",
    "Pose3D",
    "PriorFitSettings",
    "SubjectFitSettings",
    "TrainSettings",
    "analyse",
    "clean",
    "evaluate",
    "evaluate_files",
    "find_clips",
    "fit_clip",
    "load_skeleton",
    "plan_batch",
    "read_camera",
    "read_cameras",
    "read_keypoints",
    "read_pose3d",
    "read_settings",
    "run_batch",
    "run_calibration",
    "run_prediction",
    "run_prior_fit",
    "run_subject_fit",
    "run_training",
    "samples_folder",
    "write_camera",
    "write_cameras",
    "write_clip",
]

_public = lazily(__name__, __file__)
logging.getLogger(__name__).addHandler(logging.NullHandler())  # messages are for who listens to them


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from recon.base.package import version

        value: Any = version()
    else:
        value = _public(name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
