"""Metric 3D motion of a running animal from one camera and DeepLabCut keypoints.

import recon

settings = recon.FitSettings(keypoints="clip.csv", camera="camera.toml", fps=120)
motion = recon.fit_clip(settings)
motion.joints_m  # (frames, joints, 3), metres"""

import logging
from typing import TYPE_CHECKING, Any

from recon.base import lazily

if TYPE_CHECKING:
    from recon.animal.body import Body as Body
    from recon.animal.skeleton_file import load_skeleton as load_skeleton
    from recon.base.errors import InputError as InputError
    from recon.clip import Keypoints as Keypoints
    from recon.clip import clean as clean
    from recon.fit.motion import Motion as Motion
    from recon.gait.clip import ClipAnalysis as ClipAnalysis
    from recon.gait.clip import analyse as analyse
    from recon.gait.evaluation import Evaluation as Evaluation
    from recon.gait.evaluation import evaluate as evaluate
    from recon.gait.evaluation import evaluate_files as evaluate_files
    from recon.geometry.camera import Camera as Camera
    from recon.io import Pose3D as Pose3D
    from recon.io import read_camera as read_camera
    from recon.io import read_cameras as read_cameras
    from recon.io import read_keypoints as read_keypoints
    from recon.io import read_pose3d as read_pose3d
    from recon.io import write_camera as write_camera
    from recon.io import write_cameras as write_cameras
    from recon.keypoint_net.labels import LabelSource as LabelSource
    from recon.keypoint_net.network import run_prediction as run_prediction
    from recon.keypoint_net.train import TrainSettings as TrainSettings
    from recon.keypoint_net.train import run_training as run_training
    from recon.workflows.batch import find_clips as find_clips
    from recon.workflows.batch import plan_batch as plan_batch
    from recon.workflows.batch import run_batch as run_batch
    from recon.workflows.calibrate import CalibrationSettings as CalibrationSettings
    from recon.workflows.calibrate import run_calibration as run_calibration
    from recon.workflows.clip import fit_clip as fit_clip
    from recon.workflows.clip_results import read_settings as read_settings
    from recon.workflows.clip_results import write_clip as write_clip
    from recon.workflows.demo import samples_folder as samples_folder
    from recon.workflows.models import PriorFitSettings as PriorFitSettings
    from recon.workflows.models import SubjectFitSettings as SubjectFitSettings
    from recon.workflows.models import run_prior_fit as run_prior_fit
    from recon.workflows.models import run_subject_fit as run_subject_fit
    from recon.workflows.settings import FitSettings as FitSettings

    __version__: str

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
    return [*_public("__all__"), "__version__"]
